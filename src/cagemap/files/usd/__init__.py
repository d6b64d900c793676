"""USD: meshes, subsets, primvars, skeletons, layers."""
