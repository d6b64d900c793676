"""Measures of textures, run with ``python -m benchmarks.textures``: identity, there and back, tiles, memory."""
