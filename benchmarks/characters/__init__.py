"""A rigged character carried to another body, against what is known (``python -m benchmarks.characters``)."""
