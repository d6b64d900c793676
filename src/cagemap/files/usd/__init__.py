"""Reading and writing of USD: meshes, subsets, primvars, skeletons, layers."""
