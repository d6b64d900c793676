"""From fitted positions to points of the source: projected, unfolded, laid out."""
