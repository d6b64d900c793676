"""Control meshes in files: OBJ, PLY, OFF, STL, MakeHuman's .mhclo."""
