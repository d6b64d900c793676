"""Everything that touches a disk: meshes, landmarks, images and result folders; suffixes of files."""

from __future__ import annotations

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
# Of files of values at vertices, faces or corners.
VALUE_SUFFIXES = (".npy", ".npz", ".csv", ".json")
