"""The paper's method: descriptors, functional maps level by level, point maps (sections 5.1 - 5.4); and `hfm`."""
