"""The computing process: cagemap on arrays, run by Blender's own Python beside Blender.

``python -I worker.py SITE_PACKAGES`` reads pickled requests ``(name, arguments)`` from its standard input, and writes
pickled replies: any number of ``("stage", text)``, then ``("done", values)`` or ``("refused", sentence)``. It keeps the
last match, which later requests use. Meshes arrive as dicts, see `control_mesh`; positions are in Blender's world.
"""

from __future__ import annotations

import os
import pickle
import re
import sys
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import IO, Any

if __name__ == "__main__":
    sys.path.insert(1, sys.argv[1])

import numpy as np
from numpy.typing import NDArray

from cagemap.character.passengers import carry_passengers, far_passenger, unit_factor
from cagemap.character.retarget import bind_pose_difference
from cagemap.character.skeleton import carry_rig
from cagemap.character.values import Part, Rig
from cagemap.errors import CagemapError, ParameterError
from cagemap.mesh import ControlMesh, Plain
from cagemap.mesh.cage_points import NamedPoints
from cagemap.mesh.landmarks import Landmarks, pair_by_name
from cagemap.mesh.parts import extract_faces, find_part, numbers_on_part
from cagemap.mesh.repairs import RepairedMesh
from cagemap.mesh.schemes import SCHEMES
from cagemap.mesh.udim import FIRST_TILE
from cagemap.numerics.process import set_up_process
from cagemap.pipeline import choose_level, match, prepare_surfaces, update_match
from cagemap.surface.closest_points import closest_points
from cagemap.tasks.carry_arrays import carry_shapes, carry_values, carry_weights
from cagemap.tasks.carry_character import Bodies
from cagemap.tasks.match_parts import lost_landmark_notes, ready_mesh
from cagemap.tasks.progress import Stages
from cagemap.tasks.set_aside import SetAside, lay_set_aside, piece_transfer
from cagemap.transfer import BakeOptions, Transfer, bake_texture, pull_back_faces, target_tiles, transfer_of
from cagemap.transfer.skin import carry_joints
from cagemap.transfer.vectors import bake_normal_map
from cagemap.wrap import wrap

# Texels around the islands of pieces that are not matched, which are theirs too.
_BORDER = 4
# Parts of messages that only the command line and files have: the option of another answer, places in a file.
_FILE_HINTS = re.compile(r" \(`answer=\d+`\)|(?:, (?:worst|most))? at \([^)]*\)(?: of the target's file)?")

Array = NDArray[Any]
Values = dict[str, Any]
Points = dict[str, list[float]]


def control_mesh(mesh: Mapping[str, Any]) -> ControlMesh:
    """The control mesh of Blender's arrays; its UVs are the numbers of Blender's face corners.

    Keys: ``name``, ``positions`` (n, 3), ``sizes`` (m,) of the faces, ``corners`` (c,) vertices and ``loops`` (c,)
    Blender's number of every face corner; ``scheme`` and its ``options``; ``creases`` and ``sharp_corners``, each
    a pair of (k, 2) or (k,) vertices and (k,) sharpness.
    """
    loops = mesh["loops"]
    control = ControlMesh(
        mesh["positions"],
        np.concatenate([[0], np.cumsum(mesh["sizes"])]),
        mesh["corners"],
        uvs=np.column_stack([loops, np.zeros(len(loops))]).astype(np.float64),
        uv_indices=np.arange(len(loops)),
        scheme=SCHEMES[mesh["scheme"]](**mesh["options"]),
        name=mesh["name"],
    )
    if len(mesh["creases"][0]):
        control = control.with_creases(*mesh["creases"])
    return control.with_corners(*mesh["sharp_corners"]) if len(mesh["sharp_corners"][0]) else control


def largest_piece(mesh: ControlMesh) -> RepairedMesh:
    """What of a mesh is matched: its largest piece, of a plain mesh repaired."""
    part = find_part(mesh, "largest") if mesh.n_faces else None
    whole = part is None or (len(part.faces), len(np.unique(mesh.face_indices))) == (mesh.n_faces, mesh.n_vertices)
    if part is None or whole or isinstance(mesh.scheme, Plain):
        return ready_mesh(mesh)
    piece = extract_faces(mesh, part.faces)
    number = numbers_on_part(piece, mesh)
    return replace(ready_mesh(piece), vertex_of=number)


class Session:
    """The requests that Blender sends, as methods; it keeps the match that they work on."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._kept: tuple[Bodies, SetAside] | None = None

    def match(
        self, target: Values, source: Values, target_points: Points, source_points: Points, vertices: int
    ) -> Values:
        """Match two meshes; landmarks are places by name."""
        parts = [Part(mesh["name"], control_mesh(mesh)) for mesh in (target, source)]
        self._stages("prepare")
        ready = [largest_piece(part.mesh) for part in parts]
        landmarks, notes = _landmarks(parts, ready, target_points, source_points)
        levels = choose_level(ready[0].mesh, vertices), choose_level(ready[1].mesh, vertices)
        surfaces = prepare_surfaces(ready[0].mesh, ready[1].mesh, levels, progress=self._stages)
        result = match(*surfaces, landmarks, progress=self._stages)
        self._keep(Bodies((parts[0], parts[1]), (ready[0], ready[1]), result))
        repairs = [f"{one.mesh.name}: {text}" for one in ready for text in _repairs(one)]
        return self._answer([*notes, *repairs])

    def update(self, target_points: Points, source_points: Points) -> Values:
        """The map after landmarks were added, moved or removed."""
        bodies = self._matched()
        landmarks, notes = _landmarks(bodies.given, bodies.ready, target_points, source_points)
        self._keep(replace(bodies, result=update_match(bodies.result, landmarks, progress=self._stages)))
        return self._answer(list(notes))

    def image(self, place: list[float]) -> Values:
        """The place on the target that is nearest to one in space, and where the map leads it."""
        point_map = self._matched().result.point_map
        target, source = point_map.target, point_map.source
        triangle, weights, _ = closest_points(target.tree, target.scale * np.array([place]))
        corners = target.triangles[triangle[0]]
        image = weights[0] @ point_map.images.positions[corners]
        triangle, on_source, _ = closest_points(source.tree, image[None])
        return {
            "target": (weights[0] @ target.positions[corners] / target.scale).tolist(),
            "source": (on_source[0] @ source.positions[source.triangles[triangle[0]]] / source.scale).tolist(),
        }

    def values(self, vertices: dict[str, Array], corners: dict[str, Array]) -> Values:
        """Values (n, ...) of vertices and (c, ...) of face corners by name; NaN where there are none."""
        self._stages("carry values")
        bodies = self._matched()
        result, rows, loops = bodies.result, bodies.rows(1), _loops(bodies.ready[1].mesh)
        at_vertices = carry_values(result, {name: array[rows] for name, array in vertices.items()}, at="vertices")
        at_corners = carry_values(result, {name: array[loops] for name, array in corners.items()}, at="corners")
        return {
            "vertices": {name: self._on_vertices(array, vertices[name]) for name, array in at_vertices.items()},
            "corners": {name: self._on_loops(array, corners[name]) for name, array in at_corners.items()},
        }

    def weights(self, weights: Array) -> Values:
        """Skinning weights (n, j), of any sums, at the target's vertices."""
        self._stages("carry weights")
        bodies = self._matched()
        given = weights[bodies.rows(1)]
        sums = given.sum(axis=1)
        shares = np.divide(given, sums[:, None], out=np.zeros_like(given), where=sums[:, None] > 0)
        carried = carry_weights(bodies.result, shares, influences=None)
        carried *= carry_values(bodies.result, sums, at="vertices")[:, None]
        return {"weights": self._on_vertices(carried, weights)}

    def shapes(self, shapes: dict[str, Array]) -> Values:
        """Shapes as offsets (n, 3) by name."""
        self._stages("carry shapes")
        bodies, aside = self._matched(), self._aside
        carried = carry_shapes(bodies.result, {name: offsets[bodies.rows(1)] for name, offsets in shapes.items()})
        assert isinstance(carried, dict)
        offsets_by_name = {}
        for name, offsets in carried.items():
            offsets_by_name[name] = bodies.on_target(offsets)
            others = shapes[name][aside.source_vertices]
            offsets_by_name[name][aside.vertices] = np.einsum("nd,nde->ne", others, aside.turns)
        return {"shapes": offsets_by_name}

    def materials(self, materials: Array) -> Values:
        """Numbers (m,) of the source's faces at the target's faces; -1 where there are none."""
        bodies, aside = self._matched(), self._aside
        own = [
            _face_of_loop(part.mesh)[_loops(one.mesh)[one.mesh.face_offsets[:-1]]]
            for part, one in zip(bodies.given, bodies.ready, strict=True)
        ]
        count = bodies.ready[0].mesh.n_faces
        carried = np.full(bodies.given[0].mesh.n_faces, -1, dtype=np.int64)
        carried[own[0]] = pull_back_faces(transfer_of(bodies.result), materials[own[1]], n_target_faces=count)
        carried[aside.faces] = materials[aside.source_faces]
        return {"materials": carried}

    def bake(self, images: Iterable[Mapping[str, Any]], target_uvs: Array) -> Values:
        """Images in the target's layout: by name the pixels (h, w, channels) of every UDIM tile, 0 if there are none.

        Each is given as a dict of ``name``, ``pixels`` (row 0 at the top; or such by UDIM number), ``size`` (rows,
        columns) to bake, ``uvs`` (c, 2) of the source, and ``normals``, whether it is a normal map.
        """
        bodies, aside, baked = self._matched(), self._aside, {}
        result, (target, source) = bodies.result, [one.mesh for one in bodies.ready]
        laid = result.target.with_control(_laid_out(target, target_uvs))
        transfers: dict[bytes, list[Transfer]] = {}
        for image in images:
            self._stages(f"bake {image['name']}")
            key = image["uvs"].tobytes()
            if key not in transfers:
                other = result.source.with_control(_laid_out(source, image["uvs"]))
                transfers[key] = [transfer_of(replace(result, target=laid, source=other))]
                if len(aside.faces):
                    given = _laid_out(bodies.given[0].mesh, target_uvs), _laid_out(bodies.given[1].mesh, image["uvs"])
                    transfers[key].append(piece_transfer(aside, *given))
            baked[image["name"]] = _baked(transfers[key], image)
        return {"images": baked}

    def wrap(self) -> Values:
        """Positions (n, 3) of the target in the source's shape; vertices of a plain mesh go to their images."""
        self._stages("wrap")
        bodies, aside = self._matched(), self._aside
        result, mesh = bodies.result, bodies.ready[0].mesh
        if result.target.refinement.is_plain:
            wrapped = result.image()[: mesh.n_vertices]
        else:
            wrapped = wrap(result.target.refinement, result.point_map).mesh.positions
        positions = bodies.given[0].mesh.positions + bodies.on_target(wrapped - mesh.positions)
        positions[aside.vertices] = aside.places
        return {"positions": positions}

    def rig(self, names: list[str], parents: Array, matrices: Array, tails: Array) -> Values:
        """Bones of the target: matrices (j, 4, 4) to the world, tails (j, 3), whether its pose is another one."""
        self._stages("skeleton")
        point_map = self._matched().result.point_map
        rows = matrices.transpose(0, 2, 1)
        rig = Rig(tuple(names), parents, rows, rows)
        carried = carry_rig(point_map, rig)
        is_posed = bind_pose_difference(carried, rig) is not None
        matrices, tails = carried.bind.transpose(0, 2, 1), carry_joints(point_map, tails)[0]
        return {"matrices": matrices, "tails": tails, "is_posed": is_posed}

    def clothes(self, meshes: list[Values], shapes: list[dict[str, Array]]) -> Values:
        """Positions (n, 3) of meshes that sit on the source, on the target; their shapes' offsets; notes."""
        self._stages("clothes")
        result = self._matched().result
        carried, body = carry_passengers(result, [control_mesh(mesh) for mesh in meshes]), result.point_map.source
        doubts = (
            far_passenger(mesh["name"], "the source", one.distance, unit_factor(body, mesh["positions"]))
            for mesh, one in zip(meshes, carried, strict=True)
        )
        notes = [f"{doubt}: check its place and size" for doubt in doubts if doubt]
        moved = [
            {name: one.carry_offsets(offsets) for name, offsets in own.items()}
            for one, own in zip(carried, shapes, strict=True)
        ]
        return {"positions": [one.positions for one in carried], "shapes": moved, "notes": notes}

    def _keep(self, bodies: Bodies) -> None:
        self._kept = bodies, lay_set_aside(bodies)

    def _matched(self) -> Bodies:
        if self._kept is None:
            raise ParameterError("The two objects are not matched yet. Press Match.")
        return self._kept[0]

    @property
    def _aside(self) -> SetAside:
        self._matched()
        assert self._kept is not None
        return self._kept[1]

    def _answer(self, notes: list[str]) -> Values:
        """What Blender shows of a map: colours of both meshes' vertices, and sentences."""
        bodies = self._matched()
        result, places = bodies.result, bodies.given[1].mesh.positions
        low, high = places.min(axis=0), places.max(axis=0)
        colors = (places - low) / np.maximum(high - low, 1e-12)
        carried = carry_values(result, colors[bodies.rows(1)], at="vertices")
        sentences = [] if result.confidence is None else [result.confidence.message]
        sentences += [*map(str, result.suspects), *result.landmark_check.notes, *result.quality.warnings, *notes]
        return {
            "target_colors": self._on_vertices(carried, colors),
            "source_colors": colors,
            "sentences": [_FILE_HINTS.sub("", text) for text in sentences] or ["The map looks sound."],
        }

    def _on_vertices(self, carried: Array, given: Array) -> Array:
        """Values of the matched target at all its vertices; those set aside take the given ones of the source."""
        values = self._matched().on_target(carried)
        values[self._aside.vertices] = given[self._aside.source_vertices]
        return values

    def _on_loops(self, carried: Array, given: Array) -> Array:
        """Values of the matched target's corners at Blender's face corners; NaN where there are none."""
        (target, source), aside = self._matched().given, self._aside
        values = np.full((len(target.mesh.face_indices), *carried.shape[1:]), np.nan)
        values[_loops(self._matched().ready[0].mesh)] = carried
        values[_loops(target.mesh)[aside.corners]] = given[_loops(source.mesh)[aside.source_corners]]
        return values


def _baked(transfers: list[Transfer], image: Mapping[str, Any]) -> dict[int, Array]:
    """An image by tile in the layout of the matched target, over it that of the pieces set aside.

    UDIM tiles have no numbers below u = 0: a layout there is refused, since part of it would not be baked.
    """
    carry, size = bake_normal_map if image["normals"] else bake_texture, image["size"]
    drawn: dict[int, Array] = {}
    tiles: dict[int, Array] = {}
    tiled = any(target_tiles(transfer.target) != [0] for transfer in transfers)
    for transfer in transfers:
        for number in target_tiles(transfer.target):
            tile = number or (FIRST_TILE if tiled else 0)
            options = BakeOptions(tile=tile)
            pixels = carry(transfer, image["pixels"], size=size, options=options)
            own = _covered(transfer, size, replace(options, dilation=0))
            if tile in tiles:
                around = _covered(transfer, size, replace(options, dilation=_BORDER)) & ~drawn[tile]
                tiles[tile][own | around] = pixels[own | around]
            else:
                tiles[tile], drawn[tile] = pixels, own
    return tiles


def _covered(transfer: Transfer, size: tuple[int, int], options: BakeOptions) -> Array:
    """(h, w) whether a texel lies on the target's islands, or within the dilation around them."""
    white = np.full((1, 1, 1), 255, dtype=np.uint8)
    return np.asarray(bake_texture(transfer, white, size=size, options=options)[..., 0] > 0)


def _repairs(ready: RepairedMesh) -> tuple[str, ...]:
    """What was done to a mesh, but for pieces that are carried one by one."""
    return replace(ready.repairs, pieces=0).sentences()


def _laid_out(mesh: ControlMesh, uvs: Array) -> ControlMesh:
    """A mesh that was matched with UVs (c, 2) of Blender's face corners."""
    places, indices = np.unique(uvs[_loops(mesh)], axis=0, return_inverse=True)
    return mesh.with_uvs(places, indices.ravel())


def _landmarks(
    parts: Iterable[Part], ready: Iterable[RepairedMesh], target_points: Points, source_points: Points
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks of the names that both meshes have, in the numbers of what is matched."""
    if not (target_points and source_points):
        notes = ("Landmarks of one object alone are not used.",) if target_points or source_points else ()
        return Landmarks.none(), notes
    named = [
        NamedPoints(tuple(points), np.full(len(points), -1), np.array(list(points.values()), dtype=np.float64))
        for points in (target_points, source_points)
    ]
    landmarks, notes = pair_by_name(*named, *(part.mesh for part in parts))
    kept = landmarks.renumbered(*(one.vertex_of.__getitem__ for one in ready))
    return kept, (*notes, *lost_landmark_notes(landmarks, kept))


def _loops(mesh: ControlMesh) -> Array:
    """(c,) Blender's number of every face corner."""
    assert mesh.uvs is not None
    return np.asarray(mesh.uvs[mesh.uv_indices, 0].astype(np.int64))


def _face_of_loop(mesh: ControlMesh) -> Array:
    """(c,) the face that every one of Blender's face corners belongs to."""
    faces = np.empty(len(mesh.face_indices), dtype=np.int64)
    faces[_loops(mesh)] = mesh.corner_faces
    return faces


def send(stream: IO[bytes], kind: str, value: object) -> None:
    """Write one message."""
    pickle.dump((kind, value), stream, protocol=pickle.HIGHEST_PROTOCOL)
    stream.flush()


def main() -> None:
    """Answer requests until Blender closes the pipe."""
    set_up_process()
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints does not come between the replies
    session = Session(Stages(lambda stage: send(replies, "stage", stage)))
    while True:
        try:
            name, arguments = pickle.load(requests)
        except EOFError:
            return
        try:
            send(replies, "done", getattr(session, name)(**arguments))
        except CagemapError as error:
            send(replies, "refused", str(error).replace("`plain_mesh`", "the object without its Subdivision modifier"))
        except MemoryError:
            send(replies, "refused", "Not enough memory. Use fewer Vertices.")
        except Exception as error:
            traceback.print_exc()
            sentence = f"Internal error, {type(error).__name__}: {error}. This is a fault of cagemap, please report it."
            send(replies, "refused", sentence)


if __name__ == "__main__":
    main()
