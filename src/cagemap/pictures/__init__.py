"""Pictures of surfaces as image arrays, ray-cast without a screen."""

from cagemap.pictures.camera import BACK, FRONT, SIDE, VIEWS, Camera, View, frame, turn_angle
from cagemap.pictures.colors import (
    AMOUNT_SCALE,
    BALANCE_SCALE,
    TRUST_SCALE,
    distinct_colors,
    position_colors,
    scalar_colors,
)
from cagemap.pictures.orientation import (
    UP_AXES,
    Y_UP,
    Z_UP,
    Orientation,
    find_orientation,
    matching_turn,
    shape_turn,
    usual_turn,
)
from cagemap.pictures.overlay import draw_dots, draw_line, draw_segments
from cagemap.pictures.render import Image, Model, Skin, render, render_skins, sample_texture, visible_points

__all__ = [
    "AMOUNT_SCALE",
    "BACK",
    "BALANCE_SCALE",
    "FRONT",
    "SIDE",
    "TRUST_SCALE",
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
    "find_orientation",
    "frame",
    "matching_turn",
    "position_colors",
    "render",
    "render_skins",
    "sample_texture",
    "scalar_colors",
    "shape_turn",
    "turn_angle",
    "usual_turn",
    "visible_points",
]
