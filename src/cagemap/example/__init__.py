"""The built-in example: two four-legged creatures, box-modelled, unwrapped and painted by this package."""

from cagemap.example.creatures import deer, pony
from cagemap.example.modelling import Creature

__all__ = ["Creature", "deer", "pony"]
