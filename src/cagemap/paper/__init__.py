"""The paper's method: descriptors, functional maps, point maps (sections 5.1 - 5.4); and the improved `hfm`."""
