"""What is computed on surfaces, carried along maps and drawn is what it was when it was recorded."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, torus, triangulated
from tests.fixtures.vertex_pairs import points_at

from cagemap.character.passengers import carry_passengers, far_passenger, hidden_passenger
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.faces import cage_triangles, face_centres
from cagemap.mesh.parts import extract_faces
from cagemap.pictures import BALANCE_SCALE, VIEWS, Model, Skin, draw_dots, frame, position_colors, render, scalar_colors
from cagemap.pictures.colors import distinct_colors
from cagemap.pictures.orientation import find_orientation
from cagemap.pictures.overlay import draw_line, draw_segments
from cagemap.subdivision import Refinement, refine
from cagemap.surface.polylines import Polyline
from cagemap.surface.triangle_surface import SurfacePoints
from cagemap.surface.triangles import vertex_normals
from cagemap.tasks.wrap_figures import distances_text, fold_warnings, size_warnings, wrap_figures
from cagemap.transfer.attributes import bake_face_colors
from cagemap.transfer.baking import BakeOptions, Transfer, bake_texture, prepare_transfer
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes
from cagemap.transfer.control_values import control_weights
from cagemap.transfer.detail import bake_detail_heights, bake_detail_normals, detail_over
from cagemap.transfer.displacement import bake_displacement
from cagemap.transfer.masks import bake_mask
from cagemap.transfer.skin import carry_joints, carry_skin, fill_unknown
from cagemap.transfer.vectors import bake_normal_map, bake_vector_displacement
from cagemap.wrap import WrapConfig, wrap
from recorded import check

from mesh_faults import SHAPES, flip, moebius_strip, with_faces
from transfer_scenes import surface_of


def bent(control: ControlMesh, level: int) -> Refinement:
    x, y, z = control.positions.T
    return refine(
        control.with_positions(np.column_stack([1.4 * x + 0.2 * y**2, y * (1.0 + 0.3 * z), z - 0.1 * x])), level
    )


def laid_out(control: ControlMesh, columns: int) -> ControlMesh:
    """Every face in a cell of its own of a square grid."""
    corners, cells = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.arange(control.n_faces)
    places = np.column_stack([cells % columns, cells // columns])[:, None] + 0.08 + 0.84 * corners
    return control.with_uvs(places.reshape(-1, 2) / columns, np.arange(4 * control.n_faces))


@pytest.fixture(scope="module")
def pair() -> tuple[Refinement, Refinement, PointMap]:
    """A ring and a bent one of more faces, and the points of the first that are nearest."""
    target, source = bent(laid_out(torus(10, 6), 8), 2), refine(laid_out(torus(12, 8), 10), 2)
    surfaces = surface_of(target), surface_of(source)
    straight = refine(torus(10, 6), 2).finest.positions
    return target, source, PointMap(surfaces[0], SurfacePoints.nearest(surfaces[1], surfaces[1].scale * straight))


def painted(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape)).integers(0, 256, shape, dtype=np.uint8)


@pytest.mark.parametrize("kind", [None, "cloth", "rigid", "similarity"])
def test_passengers(pair: tuple[Refinement, Refinement, PointMap], kind: str | None) -> None:
    point_map = pair[2]
    skin = ControlMesh.from_faces(pair[1].finest.positions, pair[1].finest.faces, name="cloth")
    out = skin.positions + 0.06 * vertex_normals(skin.positions, cage_triangles(skin)[0])
    cloth = extract_faces(replace(skin, positions=out), np.flatnonzero(face_centres(skin)[:, 0] > 0.5))
    ball = refine(icosahedron(), 1).finest
    balls = [
        ControlMesh.from_faces(size * ball.positions + place, ball.faces, name=name)
        for name, size, place in (
            ("eye", 0.05, [2.3, 0, 0]),
            ("button", 0.12, [-1.4, 0.1, 0.8]),
            ("prop", 1.0, [9, 9, 9]),
        )
    ]
    meshes = [cloth, *balls]
    carried = carry_passengers(point_map, meshes, kinds=None if kind is None else dict.fromkeys(["cloth", "eye"], kind))
    offsets = [one.carry_offsets(0.1 * np.cos(one.positions)) for one in carried]
    notes = [
        hidden_passenger(point_map, *both) for both in zip(meshes, (one.positions for one in carried), strict=True)
    ]
    check(
        f"passengers_{kind}",
        [[one.positions for one in carried], offsets, notes, far_passenger("a", "b", 2.5, 100.0)],
        1e-5,
    )


def test_values_of_vertices(pair: tuple[Refinement, Refinement, PointMap]) -> None:
    target, source, point_map = pair
    places = source.control.positions
    skin = np.abs(np.sin(places @ np.arange(1.0, 19.0).reshape(3, 6)))
    weights, net = control_weights(point_map, target, source), surface_of(refine(target.control, 0))
    from cagemap.deform.graph import mesh_graph

    graph, trusted = mesh_graph(net, net.triangles), target.control.positions[:, 0] > -0.5
    shape = carry_shape(prepare_shapes(target, source, point_map), 0.2 * np.sin(3.0 * places))
    joints = carry_joints(point_map, places[:7] + np.array([0.1, 0.0, -0.05]))
    values = carry_skin(weights, skin / skin.sum(axis=1, keepdims=True), graph, trusted, influences=3)
    check("values_of_vertices", [weights, values, fill_unknown(values, graph, trusted), shape, joints], 1e-5)


def test_wrapped_cages(pair: tuple[Refinement, Refinement, PointMap]) -> None:
    target, _, point_map = pair
    follow = np.where(target.control.positions[:, 2] > 0.3, 0.0, 1.0)
    found = []
    for config, given in ((WrapConfig(), None), (WrapConfig(level=1, fairness=1e-2), None), (WrapConfig(), follow)):
        wrapped = wrap(target, point_map, config, follow=given)
        figures = wrap_figures(wrapped)
        found += [figures, wrapped.mesh.positions, wrapped.follow, wrapped.aspect, distances_text(figures, 0.5)]
    folds = [fold_warnings({"folded_faces": list(range(count))}) for count in (0, 10, 11)]
    sizes = [size_warnings(np.eye(3), factor * np.eye(3)) for factor in (0.3, 1 / 3, 3.0, 3.1)]
    check("wrapped_cages", [found, folds, sizes], 1e-3)


def test_quality_of_a_map(pair: tuple[Refinement, Refinement, PointMap]) -> None:
    point_map = pair[2]
    marks = points_at(point_map.target, point_map.source, np.array([0, 9, 40]), np.array([0, 11, 30]))
    marks = replace(marks, names=("a", "b", "c"))
    masks = Masks(np.clip(point_map.target.positions[:, 0] + 0.4, 0.0, 1.0), np.ones(point_map.source.n))
    squeezed = np.where(np.abs(point_map.images.positions) > 0.2, 0.3, 1.0) * point_map.images.positions
    worse = PointMap(point_map.target, SurfacePoints.nearest(point_map.source, squeezed))
    cases = (point_map, None), (point_map, marks), (worse, marks)
    found = [measure_quality(of, named, masks=given) for of, named in cases for given in (Masks(), masks)]
    check("quality_of_a_map", [[one.summary(), one.trust, one.warnings] for one in found], 1e-5)


@pytest.fixture(scope="module")
def transfer(pair: tuple[Refinement, Refinement, PointMap]) -> Transfer:
    target, source, point_map = pair
    masks = Masks(np.clip(point_map.target.positions[:, 0] + 0.4, 0.0, 1.0), np.ones(point_map.source.n))
    return prepare_transfer(target.finest, source.finest, point_map, masks)


BAKES = {
    "texture": partial(bake_texture, texture=painted(60, 80, 3), size=(40, 48)),
    "small texture": partial(bake_texture, texture=painted(300, 200, 4), size=24),
    "linear": partial(
        bake_texture, texture=painted(20, 30) / 255.0, size=40, options=BakeOptions(filter="linear", supersample=2)
    ),
    "labels": partial(
        bake_texture, texture=painted(20, 30), size=40, options=BakeOptions(filter="nearest", dilation=2)
    ),
    "tiles": partial(
        bake_texture, texture={1001: painted(16, 16, 3), 1002: painted(8, 8, 3)}, size=32, dtype=np.uint16
    ),
    "normals": partial(bake_normal_map, texture=painted(40, 40, 3), size=32, green="down"),
    "world normals": partial(bake_normal_map, texture=painted(40, 40, 3), size=32, space="object"),
    "vectors": partial(bake_vector_displacement, texture=painted(40, 40, 3), size=32, scale=0.1),
    "heights": partial(bake_displacement, texture=painted(40, 40), size=32, scale=2.0),
    "float heights": partial(bake_displacement, texture=painted(40, 40) / 99.0, size=32, midlevel=0.3),
    "colors": partial(bake_face_colors, colors=painted(96, 3) / 255.0, size=40),
    "mask": partial(bake_mask, size=32),
}


@pytest.mark.parametrize("name", BAKES)
def test_baked_images(transfer: Transfer, name: str) -> None:
    check(f"baked_{name.replace(' ', '_')}", BAKES[name](transfer), 1e-5)


def test_baked_detail(pair: tuple[Refinement, Refinement, PointMap], transfer: Transfer) -> None:
    source = pair[2].source
    finer = refine(torus(12, 8), 3).finest
    moved = finer.positions + 0.03 * np.sin(9.0 * finer.positions[:, [1, 2, 0]])
    detail = detail_over(source, moved, surface_of(refine(torus(12, 8), 3)).triangles)
    check(
        "baked_detail",
        [bake_detail_normals(transfer, detail, size=24), bake_detail_heights(transfer, detail, size=24)],
        1e-4,
    )


def test_reports_of_meshes() -> None:
    shapes = {name: make() for name, (make, *_) in SHAPES.items()}
    box = cube()
    shapes |= {
        "flipped": flip(box, 2),
        "all flipped": flip(box, range(6)),
        "doubled": with_faces(box, [0, 1, 3, 2]),
        "fin": with_faces(box, [0, 1, 6]),
        "one-sided": moebius_strip(),
        "loose": replace(box, positions=np.vstack([box.positions, [[9.0, 9.0, 9.0]]])),
        "flat": box.with_positions(box.positions * [1.0, 1.0, 0.0]),
        "laid out": laid_out(torus(6, 4), 5),
    }
    check("reports_of_meshes", {name: [check_mesh(mesh), str(check_mesh(mesh))] for name, mesh in shapes.items()})


def blocks(image: np.ndarray) -> np.ndarray:
    """Mean colours of blocks of 12 by 12 pixels."""
    return image.reshape(image.shape[0] // 12, 12, image.shape[1] // 12, 12, 3).mean(axis=(1, 3))


def test_pictures() -> None:
    finest = refine(triangulated(creature()), 1).finest
    model, places = Model(finest.positions, finest.faces), finest.positions
    corner_uvs = np.abs(np.sin(places[finest.faces][..., :2]))
    skins = [
        Skin(),
        Skin(vertex_colors=position_colors(places, places)),
        Skin(face_colors=distinct_colors(len(finest.faces))),
        Skin(texture=painted(9, 7, 3) / 255.0, corner_uvs=corner_uvs),
    ]
    found = []
    for view, skin in zip((*VIEWS, VIEWS[0]), skins, strict=True):
        camera = frame(places, view)
        image = render(model, skin, camera, width=96, height=72)
        dotted = draw_dots(image, model, camera, places[::9], distinct_colors(len(places[::9])), radius=2.5)
        lined = draw_line(
            dotted, model, camera, Polyline(places[finest.faces[:9, 0]], False), np.array([1.0, 0.2, 0.0])
        )
        crossed = draw_segments(lined, model, camera, places[finest.faces[::5, :2]], np.array([0.0, 0.2, 1.0]))
        found += [[camera.eye, camera.axes], *map(blocks, (image, dotted, lined, crossed))]
    values = np.array([-3.0, -0.9, 0.0, 0.4, 2.0, np.nan])
    colors = [
        scalar_colors(values, -1.0, 1.5),
        scalar_colors(values, 0.0, 0.0, BALANCE_SCALE),
        position_colors(places, places[:9], 5),
    ]
    turned = places @ np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    fronts = [[one.turn, str(one)] for one in (find_orientation(of, finest.faces) for of in (places, turned, -turned))]
    check("pictures", [found, colors, fronts], 1e-3)
