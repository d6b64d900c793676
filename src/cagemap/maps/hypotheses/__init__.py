"""A map without landmarks: how the target may lie on the source, which of the ways is right, and how sure that is."""
