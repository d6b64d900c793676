"""The built-in example: two four-legged creatures, box-modelled, unwrapped and painted by this package."""

from cagemap.example.creatures import deer, pony
from cagemap.example.modelling import CHANNELS, Creature
from cagemap.example.paint import paint_displacement, paint_texture
from cagemap.example.pair import ExamplePair, creature_landmarks, example_pair

__all__ = [
    "CHANNELS",
    "Creature",
    "ExamplePair",
    "creature_landmarks",
    "deer",
    "example_pair",
    "paint_displacement",
    "paint_texture",
    "pony",
]
