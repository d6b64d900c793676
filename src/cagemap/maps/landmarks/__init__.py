"""Check landmarks: find pairs that contradict the others."""
