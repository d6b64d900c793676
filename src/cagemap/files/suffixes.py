"""Suffixes of files, for several packages; nothing is loaded for it."""

from __future__ import annotations

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
# Of files of values at vertices, faces or corners.
VALUE_SUFFIXES = (".npy", ".npz", ".csv", ".json")
