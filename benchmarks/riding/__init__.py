"""Measures of what rides on a map (``python -m benchmarks.riding``): weights, joints, shapes, bindings, images."""
