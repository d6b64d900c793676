"""How the built-in example was made: two four-legged creatures, box-modelled, unwrapped and painted by this package.

``python -m examples.creatures`` writes the files that `cagemap.example` holds.
"""
