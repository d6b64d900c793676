"""A map without landmarks: candidate alignments, the best of them, and how sure it is."""
