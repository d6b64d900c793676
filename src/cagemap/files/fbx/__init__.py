"""FBX, read by the library ufbx in a process of its own and handed over as glTF."""
