"""Pictures of surfaces as image arrays, ray-cast without a screen."""

from cagemap.pictures.camera import BACK, FRONT, SIDE, VIEWS, Camera, View, frame, turn_between
from cagemap.pictures.colors import (
    AMOUNT,
    BALANCE,
    ENOUGH,
    distinct_colors,
    position_colors,
    scalar_colors,
    to_display,
    to_linear,
)
from cagemap.pictures.orientation import UP_AXES, Y_UP, Z_UP, Orientation, matching_turn, orientation
from cagemap.pictures.overlay import draw_dots, draw_line, draw_segments
from cagemap.pictures.render import Image, Model, Skin, render, sample_texture, visible

__all__ = [
    "AMOUNT",
    "BACK",
    "BALANCE",
    "ENOUGH",
    "FRONT",
    "SIDE",
    "UP_AXES",
    "VIEWS",
    "Y_UP",
    "Z_UP",
    "Camera",
    "Image",
    "Model",
    "Orientation",
    "Skin",
    "View",
    "distinct_colors",
    "draw_dots",
    "draw_line",
    "draw_segments",
    "frame",
    "matching_turn",
    "orientation",
    "position_colors",
    "render",
    "sample_texture",
    "scalar_colors",
    "to_display",
    "to_linear",
    "turn_between",
    "visible",
]
