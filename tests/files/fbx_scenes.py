"""Small binary FBX files that tests share."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from examples.shapes import cube

from cagemap.character.poses import pose_at
from cagemap.character.values import Character, skinned_positions
from cagemap.mesh import ControlMesh

SECOND = 46_186_158_000  # in FBX's unit of time
# Metres, Y up, as rows, to centimetres, Z up.
TO_FBX = 100.0 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_ARRAYS = {"f8": b"d", "f4": b"f", "i4": b"i", "i8": b"l"}


@dataclass
class Node:
    """A record: name, properties (int, float, str, bytes or array), and records inside."""

    name: str
    properties: Sequence[Any] = ()
    inside: list[Node] = field(default_factory=list)

    def written(self, start: int) -> bytes:
        """Its bytes, where it begins at ``start`` of the file."""
        values = b"".join(map(_property, self.properties))
        head = 13 + len(self.name)
        body = values
        for one in self.inside:
            body += one.written(start + head + len(body))
        if self.inside:
            body += bytes(13)
        sizes = struct.pack("<IIIB", start + head + len(body), len(self.properties), len(values), len(self.name))
        return sizes + self.name.encode() + body


def _property(value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value).tobytes()
        return _ARRAYS[value.dtype.str[1:]] + struct.pack("<III", value.size, 0, len(data)) + data
    if isinstance(value, bytes):
        return b"R" + struct.pack("<I", len(value)) + value
    if isinstance(value, str):
        return b"S" + struct.pack("<I", len(value.encode())) + value.encode()
    return b"L" + struct.pack("<q", value) if isinstance(value, int) else b"D" + struct.pack("<d", value)


def properties(**values: Any) -> Node:
    """A list of properties; underscores stand for spaces and colours are three numbers."""
    kinds = {str: ("KString", "", ""), int: ("int", "Integer", ""), float: ("double", "Number", "")}
    found = []
    for name, value in values.items():
        kind = kinds.get(type(value), ("Vector3D", "Vector", "A"))
        row = (value,) if type(value) in kinds else tuple(map(float, value))
        found.append(Node("P", (name.replace("_", " "), *kind, *row)))
    return Node("Properties70", (), found)


class Fbx:
    """Collects objects and what connects them."""

    def __init__(self, **settings: Any) -> None:
        axes = {"UpAxis": 2, "UpAxisSign": 1, "FrontAxis": 1, "FrontAxisSign": -1, "CoordAxis": 0, "CoordAxisSign": 1}
        self.settings = properties(**(axes | {"UnitScaleFactor": 1.0} | settings))
        self.objects: list[Node] = []
        self.connections: list[Node] = []
        self._numbers = itertools.count(1000)

    def add(self, kind: str, name: str, of: str, *inside: Node, to: int | None = 0, by: str = "") -> int:
        """Add an object, connected to another one, or to a property of it; returns its number."""
        number = next(self._numbers)
        words = {"Deformer": "SubDeformer" if "Cluster" in of or "Channel" in of else "Deformer"}
        words |= {"AnimationStack": "AnimStack", "AnimationLayer": "AnimLayer", "AnimationCurve": "AnimCurve"}
        words["AnimationCurveNode"] = "AnimCurveNode"
        self.objects.append(Node(kind, (number, f"{name}\0\1{words.get(kind, kind)}", of), list(inside)))
        if to is not None:
            self.connect(number, to, by)
        return number

    def named(self, kind: str, of: str = "") -> Node:
        """The first object of a kind, and of a kind within it."""
        return next(one for one in self.objects if one.name == kind and of in ("", one.properties[2]))

    def connect(self, number: int, to: int, by: str = "") -> None:
        """Connect an object to another one, or to a property of it."""
        self.connections.append(Node("C", ("OP", number, to, by) if by else ("OO", number, to)))

    def bytes(self) -> bytes:
        """The file."""
        top = [
            Node("FBXHeaderExtension", (), [Node("FBXVersion", (7400,))]),
            Node("GlobalSettings", (), [Node("Version", (1000,)), self.settings]),
            Node("Objects", (), self.objects),
            Node("Connections", (), self.connections),
        ]
        made = b"Kaydara FBX Binary  \0\x1a\0" + struct.pack("<I", 7400)
        for one in top:
            made += one.written(len(made))
        return made + bytes(13)


def polygons(faces: Sequence[Sequence[int]]) -> np.ndarray:
    """Vertices of all corners, the last one of each face negative."""
    return np.array([v for face in faces for v in (*face[:-1], -face[-1] - 1)], dtype="<i4")


def layer(kind: str, name: str, mapping: str, **arrays: np.ndarray) -> Node:
    """A layer element, such as UVs for every corner of the faces."""
    refers = "IndexToDirect" if len(arrays) > 1 or kind == "Material" else "Direct"
    stated = [
        Node("Version", (101,)),
        Node("Name", (name,)),
        Node("MappingInformationType", (mapping,)),
        Node("ReferenceInformationType", (refers,)),
    ]
    return Node(f"LayerElement{kind}", (0,), stated + [Node(word, (array,)) for word, array in arrays.items()])


def geometry(points: np.ndarray, faces: Sequence[Sequence[int]], *elements: Node) -> list[Node]:
    """What a mesh holds; points (n, 3) in centimetres, Z up."""
    kinds = [Node("LayerElement", (), [Node("Type", (one.name,)), Node("TypedIndex", (0,))]) for one in elements]
    return [
        Node("Vertices", (points.astype("<f8").ravel(),)),
        Node("PolygonVertexIndex", (polygons(faces),)),
        *elements,
        Node("Layer", (0,), [Node("Version", (100,)), *kinds]),
    ]


def add_layer(made: Fbx, element: Node) -> None:
    """Add a layer element, in a layer of its own, to the first mesh."""
    inside = made.named("Geometry", "Mesh").inside
    element.properties = (sum(one.name == element.name for one in inside),)
    named = Node("LayerElement", (), [Node("Type", (element.name,)), Node("TypedIndex", element.properties)])
    number = sum(one.name == "Layer" for one in inside)
    inside += [element, Node("Layer", (number,), [Node("Version", (100,)), named])]


def write_fbx(path: Path, mesh: ControlMesh) -> None:
    """Write a mesh in metres with Y up, with its UVs."""
    made = Fbx(UpAxis=1, FrontAxis=2, FrontAxisSign=1, UnitScaleFactor=100.0)
    faces = [mesh.face(number).tolist() for number in range(mesh.n_faces)]
    uv = layer("UV", "map", "ByPolygonVertex", UV=mesh.uvs.ravel(), UVIndex=mesh.uv_indices.astype("<i4"))
    model = made.add("Model", mesh.name, "Mesh")
    made.add("Geometry", mesh.name, "Mesh", *geometry(mesh.positions, faces, uv), to=model)
    path.write_bytes(made.bytes())


def fbx_arm(*, image: bytes = b"", leaf: bool = False, posed: bool = False, **skin: Any) -> Fbx:
    """The strip of `gltf_scenes.arm`, as quads, in centimetres with Z up; a shape, a texture, an animation.

    With ``leaf`` the second joint has a bone behind it that moves nothing; with ``posed`` it is turned in the file.
    ``skin`` are properties of the material.
    """
    made = Fbx()
    points = np.array([(x, y, 0.0) for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0)])
    faces = [(0, 2, 3, 1), (2, 4, 5, 3)]
    uv = layer(
        "UV", "map", "ByPolygonVertex", UV=(points[:, :2] / 2).ravel(), UVIndex=np.array(sum(faces, ()), dtype="<i4")
    )
    slots = layer("Material", "", "AllSame", Materials=np.zeros(1, "<i4"))
    model = made.add("Model", "strip", "Mesh")
    mesh = made.add("Geometry", "strip", "Mesh", *geometry(points @ TO_FBX, faces, uv, slots), to=model)
    material = made.add("Material", "skin", "", properties(DiffuseColor=(0.5, 0.25, 1.0), **skin), to=model)
    if image:
        named = [Node("FileName", ("C:\\work\\skin.png",)), Node("RelativeFilename", ("..\\skin.png",))]
        texture = made.add("Texture", "skin", "", *named, to=material, by="DiffuseColor")
        made.add("Video", "skin", "Clip", *named, Node("Content", (image,)), to=texture)
    raised = np.array([(0.0, 0.0, 1.0)] * 2) @ TO_FBX
    blend = made.add("Deformer", "", "BlendShape", to=mesh)
    full = Node("FullWeights", (np.array([100.0]),))
    channel = made.add("Deformer", "raise", "BlendShapeChannel", Node("DeformPercent", (0.0,)), full, to=blend)
    offsets = [Node("Indexes", (np.array([4, 5], "<i4"),)), Node("Vertices", (raised.ravel(),))]
    made.add("Geometry", "raise", "Shape", *offsets, to=channel)
    turned = {"Lcl_Rotation": (0.0, -30.0, 0.0)} if posed else {}
    upper = made.add("Model", "upper", "LimbNode")
    lower = made.add("Model", "lower", "LimbNode", properties(Lcl_Translation=(100.0, 0, 0), **turned), to=upper)
    if leaf:
        made.add("Model", "lower_end", "LimbNode", properties(Lcl_Translation=(100.0, 0, 0)), to=lower)
    skin = made.add("Deformer", "", "Skin", to=mesh)
    for bone, x, rows, amounts in (
        (upper, 0.0, (0, 1, 2, 3), (1, 1, 0.5, 0.5)),
        (lower, 1.0, (2, 3, 4, 5), (0.5, 0.5, 1, 1)),
    ):
        matrices = [np.eye(4), np.eye(4)]
        matrices[0][3, 0], matrices[1][3, 0] = -100.0 * x, 100.0 * x
        cluster = made.add(
            "Deformer",
            "",
            "Cluster",
            Node("Indexes", (np.array(rows, "<i4"),)),
            Node("Weights", (np.array(amounts, "<f8"),)),
            Node("Transform", (matrices[0].ravel(),)),
            Node("TransformLink", (matrices[1].ravel(),)),
            to=skin,
        )
        made.connect(bone, cluster)
    _animate(made, lower, channel)
    return made


def _animate(made: Fbx, lower: int, channel: int) -> None:
    """In half a second the second joint turns by 90 degrees about the axis of depth, and the shape is half there."""
    stack = made.add("AnimationStack", "bend", "", to=None)
    made.add("AnimationLayer", "base", "", to=stack)
    add_curve(made, lower, "Lcl Rotation", "d|Y", (0.0, -90.0, 0.0))
    add_curve(made, channel, "DeformPercent", "d|DeformPercent", (0.0, 50.0, 0.0))


def add_curve(
    made: Fbx, target: int, prop: str, name: str, values: tuple[float, float, float], others: float = 0.0
) -> None:
    """Move a component of a property in the last animation layer: values at 0, 0.5 and 2 seconds."""
    layer_of = next(one.properties[0] for one in reversed(made.objects) if one.name == "AnimationLayer")
    rest = {f"d|{axis}": others for axis in "XYZ"} if others else {}
    curve_node = made.add("AnimationCurveNode", prop[0], "", properties(**rest | {name: values[0]}), to=layer_of)
    made.connect(curve_node, target, prop)
    keys = [
        Node("KeyTime", (np.array([0, SECOND // 2, 2 * SECOND], "<i8"),)),
        Node("KeyValueFloat", (np.array(values, "<f4"),)),
        Node("KeyAttrFlags", (np.array([4], "<i4"),)),  # linear
        Node("KeyAttrDataFloat", (np.zeros(4, "<f4"),)),
        Node("KeyAttrRefCount", (np.array([3], "<i4"),)),
    ]
    made.add("AnimationCurve", "", "", *keys, to=curve_node, by=name)


def fbx_file(folder: Path, made: Fbx, name: str = "arm.fbx") -> Path:
    """Path of the written file."""
    path = folder / name
    path.write_bytes(made.bytes())
    return path


def half_a_second_in(character: Character) -> np.ndarray:
    """Positions of the first part at 0.5 s of the first animation."""
    return skinned_positions(character.parts[0], character.rig, pose_at(character.rig, character.animations[0], 0.5))


PNG = b"\x89PNG" + bytes(60)
BOX = geometry(cube().positions, cube().face_indices.reshape(-1, 4))
