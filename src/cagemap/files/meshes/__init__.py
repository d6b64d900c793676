"""Reading and writing of control meshes: OBJ, PLY, OFF, STL, MakeHuman's .mhclo."""
