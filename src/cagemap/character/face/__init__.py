"""Data of `cagemap face`: the head and shapes of ICT-FaceKit (MIT), made by `benchmarks/face_kit.py`."""
