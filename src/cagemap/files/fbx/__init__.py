"""FBX files, read by the library ufbx in a child process and converted to glTF."""
