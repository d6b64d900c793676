"""Everything that touches a disk: meshes, landmarks, images and result folders."""
