"""Point maps: search in the spectral embedding, elastic fit, quality."""
