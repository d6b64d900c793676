"""Reading and writing of files: meshes, characters, landmarks, images and result folders."""

from __future__ import annotations

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
# Suffixes of files that hold values at vertices, faces or corners.
VALUE_SUFFIXES = (".npy", ".npz", ".csv", ".json")
# Suffixes of mask files, and the prefix of a mask's name that inverts it.
MASK_SUFFIXES = (*VALUE_SUFFIXES, *IMAGE_SUFFIXES)
INVERT_PREFIX = "not:"
# Option of an output that names a USD layer; several outputs of a pair may add to one layer.
LAYER_OPTION = "usd"
