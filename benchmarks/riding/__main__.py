"""``python -m benchmarks.riding [PART ...] [--out FILE]``: what rides on a map, measured against what is known.

identity (the same body on both sides), back (weights and normal maps onto another cage of the same shape and back),
shapes, joints (between bodies of known truth), rig (MakeHuman's weights on other cages), binding (.mhclo). Each row is
printed, and appended to FILE as JSON.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy import sparse

import cagemap
from benchmarks.accuracy.posed import landmarks_of
from benchmarks.riding.scenes import body, inner_places, normal_image, skin_of
from benchmarks.textures.__main__ import DATA, psnr, requadded, touched
from cagemap.character.joints import Skeleton
from cagemap.files.images.image import read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.meshes.mhclo import bind
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.files.values.rigs import read_skeleton, write_skeleton
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import choose_level, match, prepare_surface
from cagemap.spectral import Surface
from cagemap.subdivision import finest_mesh, refine
from cagemap.surface.triangles import normalize_rows
from cagemap.tasks.carry_arrays import carry_weights
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.transfer import unwrap
from cagemap.transfer.blend_shapes import carry_shape, prepare_shapes
from cagemap.transfer.skin import carry_joints

Row = tuple[str, str]
VERTICES = 25_000
PAIRS = (
    ("female1605", "male1591"),
    ("male1591", "female1605"),
    ("base", "soma18056"),
    ("soma18056", "base"),
    ("male1591", "base"),
    ("base", "male1591"),
    ("proxy741", "base"),
    ("base", "proxy741"),
    ("anny10pc", "anny5pc"),
    ("anny10pc", "base"),
)
# An animal, its other cage (see `benchmarks.textures`), and how steep the bumps are.
CAGES = (("spot", "refined", 1.0), ("spot", "turned", 1.0), ("blub", "refined", 1.0), ("spot", "refined", 3.0))


@cache
def _surface(cage: str, identity: str) -> Surface:
    control = body(cage, identity)
    return prepare_surface(control, choose_level(control, VERTICES))


@cache
def _found(target: str, source: str, of: str, to: str) -> MatchResult:
    """Match of two bodies with 14 landmarks: identity ``of`` for the target, ``to`` for the source."""
    return match(_surface(target, of), _surface(source, to), landmarks_of(target, source, 14))


def identity() -> Iterator[Row]:
    """One body on both sides of `cagemap match`; every kind of file through `cagemap transfer`."""
    size, mesh = 2048, body("female1605", "male_young")
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_mesh(root / "body.obj", mesh)
        picked = np.linspace(0, mesh.n_vertices - 1, 14).astype(int)
        names = tuple(f"p{k}" for k in range(len(picked)))
        write_landmarks(root / "marks.json", Landmarks(names, picked, picked, "body.obj", "body.obj"))
        run_match(
            MatchRequest(root / "body.obj", root / "body.obj", root / "R", root / "marks.json", vertices=90_000),
            Stages(),
        )

        def carried(output: str, **given: object) -> Path:
            run_transfer(TransferRequest(root / "R", root / output, **given), Stages())  # type: ignore[arg-type]
            return root / output

        values = {
            "weights": skin_of(mesh),
            "labels": rng.integers(0, 9, mesh.n_vertices),
            "face_labels": rng.integers(0, 9, mesh.n_faces),
            "corners": rng.random((len(mesh.face_indices), 2)),
        }
        for name, array in values.items():
            write_attributes(root / f"{name}.npz", {name: array})
            asked = {"weights": root / "weights.npz"} if name == "weights" else {"attribute": root / f"{name}.npz"}
            back = read_attributes(carried(f"{name}_back.npz", **asked))[name]
            yield f"identity: {name}", f"largest difference {np.abs(back - array).max():.1e}"
        shape = body("female1605", "female_old_heavy").positions - mesh.positions
        np.savez(root / "shape.npz", old=shape)
        with np.load(carried("shapes.npz", blend_shapes=(root / "shape.npz",))) as shapes:
            error = np.abs(shapes["old"] - shape).max() / np.ptp(mesh.positions)
        yield "identity: blend shapes", f"largest difference {error:.1e} of the body's height"
        joints = mesh.positions[inner_places(mesh, 40)].mean(axis=1)
        skeleton = Skeleton(tuple(f"j{k}" for k in range(len(joints))), ("",) * len(joints), joints, joints + 0.1)
        write_skeleton(root / "joints.json", skeleton)
        heads = read_skeleton(carried("joints_back.json", joints=root / "joints.json")).heads
        yield "identity: joints", f"largest difference {np.abs(heads - joints).max() / np.ptp(mesh.positions):.1e}"
        transfer = cagemap.transfer_of(cagemap.read_result(root / "R"))
        inside = touched(transfer, size)
        noise = rng.integers(0, 256, (size, size, 3)).astype(np.uint8)
        directions = normalize_rows(rng.standard_normal((size * size, 3)) + np.array([0.0, 0.0, 2.0]))
        normals = np.rint((0.5 * directions + 0.5) * 255).astype(np.uint8).reshape(size, size, 3)
        moves = rng.standard_normal((size, size, 3)).astype(np.float32)
        for name, image in (("noise", noise), ("normals", normals)):
            write_image(root / f"{name}.png", image)
        write_image(root / "moves.exr", moves)
        asked_images: dict[str, dict[str, object]] = {
            "noise": {"texture": root / "noise.png"},
            "normals, tangent, green up": {"normal_map": root / "normals.png"},
            "normals, tangent, green down": {"normal_map": root / "normals.png", "green": "down"},
            "normals, object": {"normal_map": root / "normals.png", "space": "object"},
        }
        for k, (name, asked) in enumerate(asked_images.items()):
            back = read_image(carried(f"image{k}.png", **asked)).pixels.astype(int)
            off = np.abs(back - (noise if name == "noise" else normals)).max(axis=2)[inside]
            yield f"identity: {name}", f"{np.count_nonzero(off > 1)} of {len(off)} texels more than a level off"
        for space in ("tangent", "object"):
            image = carried(f"moves_{space}.exr", vector_displacement=root / "moves.exr", space=space)
            error = np.abs(read_image(image).pixels - moves)[inside].max()
            yield f"identity: vector displacement, {space}", f"largest difference {error:.1e}, values about 1"


def back() -> Iterator[Row]:
    """Onto another cage of the same shape and back, by two real matches."""
    for one, other in (("base", "soma18056"), ("soma18056", "base"), ("female1605", "male1591"), ("base", "male1591")):
        there, home = (_found(*cages, "male_young", "male_young") for cages in ((other, one), (one, other)))
        given = skin_of(body(one, "male_young"))
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            cagemap.write_result(root / "there", there)
            cagemap.write_result(root / "home", home)
            write_attributes(root / "given.npz", {"w": given})
            for result, weights, output in (("there", "given", "between"), ("home", "between", "returned")):
                request = TransferRequest(root / result, root / f"{output}.npz", weights=root / f"{weights}.npz")
                run_transfer(request, Stages())
            between, returned = (read_attributes(root / f"{name}.npz")["w"] for name in ("between", "returned"))
        off = 0.5 * np.abs(returned - given).sum(axis=1)
        most = int((between > 0).sum(axis=1).max())
        sums = max(float(np.abs(table.sum(axis=1) - 1).max()) for table in (between, returned))
        yield (
            f"weights {one} -> {other} -> {one}",
            f"mean {np.abs(returned - given)[given > 0].mean():.4f} of the weights given; {off.mean():.4f} of a "
            f"vertex's weight on other joints, 99 % below {np.quantile(off, 0.99):.3f}; at most {most} joints, sums to "
            f"{sums:.0e}",
        )


def normals_back(cages: tuple[tuple[str, str, float], ...] = CAGES) -> Iterator[Row]:
    """A normal map of 4096 onto another cage of the same shape, with a layout of its own, and back."""
    size = 4096
    for name, kind, steep in cages:
        mesh = read_mesh(DATA / "animals" / f"{name}.obj")
        plain = replace(finest_mesh(refine(mesh, 1)), uvs=None, uv_indices=None)
        other = unwrap(requadded(mesh) if kind == "turned" else plain)
        image = normal_image(size, steep)
        with tempfile.TemporaryDirectory() as folder:
            result, returned = _there_and_back(Path(folder), mesh, other, image, size)
            where = touched(cagemap.transfer_of(result), size)
        wrong = np.degrees(np.arccos(np.clip((_unit(returned[where]) * _unit(image[where])).sum(axis=1), -1, 1)))
        yield (
            f"normal map {size}, {steep:g} times as steep, {name}, {kind} cage, and back",
            f"{psnr(returned, image, where):.2f} dB; {wrong.mean():.2f} degrees on average, "
            f"{np.quantile(wrong, 0.99):.1f} for 99 %",
        )


def _there_and_back(
    root: Path, mesh: ControlMesh, other: ControlMesh, image: np.ndarray, size: int
) -> tuple[MatchResult, np.ndarray]:
    """The way back's RESULT, and the normal map that came back."""
    write_mesh(root / "one.obj", mesh)
    write_mesh(root / "other.obj", other)
    write_image(root / "given.png", image)
    picked = np.linspace(0, mesh.n_vertices - 1, 12).astype(int)
    names = tuple(f"p{k}" for k in range(len(picked)))
    steps = (("other", "one", "given", "between"), ("one", "other", "between", "returned"))
    for target, source, given, output in steps:
        marks, result = root / f"{output}.json", root / f"R_{output}"
        write_landmarks(marks, Landmarks(names, picked, picked, f"{target}.obj", f"{source}.obj"))
        run_match(MatchRequest(root / f"{target}.obj", root / f"{source}.obj", result, marks), Stages())
        request = TransferRequest(result, root / f"{output}.png", normal_map=root / f"{given}.png", size=size)
        run_transfer(request, Stages())
    return cagemap.read_result(root / "R_returned"), read_image(root / "returned.png").pixels


def _unit(pixels: np.ndarray) -> np.ndarray:
    return normalize_rows(pixels.astype(np.float64) / 255 * 2 - 1)


def shapes() -> Iterator[Row]:
    """What makes a young man an old heavy woman, as a blend shape, onto another cage of the young man."""
    for target, source in PAIRS:
        found = _found(target, source, "male_young", "male_young")
        known = _known(target, source)
        carrier = prepare_shapes(found.target.refinement, found.source.refinement, found.point_map)
        given, true = (
            body(cage, "female_old_heavy").positions - body(cage, "male_young").positions for cage in (source, target)
        )
        error = np.linalg.norm(carry_shape(carrier, given) - true, axis=1)[known]
        size = np.linalg.norm(true, axis=1)[known].mean()
        yield (
            f"blend shape {source} -> {target}",
            f"{error.mean() / size:.3f} of its mean size, 99 % below {np.quantile(error, 0.99) / size:.2f}",
        )


def rig() -> Iterator[Row]:
    """MakeHuman's weights of `base` (all influences) on two other cages: another body, another, and the same one."""
    with np.load(DATA / "characters" / "rigs" / "weights_body.npz") as file:
        skin = sparse.csr_array((file["data"], file["indices"], file["indptr"]), shape=tuple(file["shape"])).toarray()
    skin /= skin.sum(axis=1, keepdims=True)
    for target in ("soma18056", "female1605"):
        with np.load(DATA / "humans" / "ground_truth" / f"base__{target}.npz") as truth:
            true = np.einsum("nk,nkj->nj", truth["b_to_a_bary"], skin[truth["b_to_a_verts"]])
            known = truth["b_to_a_valid"]
        true /= true.sum(axis=1, keepdims=True)
        for of, to in (("female_old_heavy", "male_young"), ("male_young", "neutral"), ("male_young", "male_young")):
            found = _found(target, "base", of, to)
            off = {
                count: 0.5 * np.abs(carry_weights(found, skin, influences=count) - true).sum(axis=1)[known]
                for count in (4, None)
            }
            yield (
                f"rig of base, {to}, on {target}, {of}",
                f"total variation {off[4].mean():.3f} at four a vertex, {off[None].mean():.3f} with all "
                f"(median {np.median(off[None]):.3f})",
            )


def _known(target: str, source: str) -> np.ndarray:
    """(n,) control vertices of the target with a true place on the source: on a closed mouth a mouth bag has none."""
    folder = DATA / "humans" / "ground_truth"
    if (folder / f"{target}__{source}.npz").is_file():
        return np.asarray(np.load(folder / f"{target}__{source}.npz")["a_to_b_valid"])
    return np.asarray(np.load(folder / f"{source}__{target}.npz")["b_to_a_valid"])


def joints() -> Iterator[Row]:
    """Points half-way across limbs of `base`, young man, carried to another cage of the old heavy woman."""
    for target in ("base", "soma18056", "male1591", "proxy741", "anny10pc"):
        source = "base" if target != "base" else "soma18056"
        found = _found(target, source, "female_old_heavy", "male_young")
        ends = inner_places(body(source, "neutral"), 60)
        places = [body(source, name).positions[ends].mean(axis=1) for name in ("male_young", "female_old_heavy")]
        error = np.linalg.norm(carry_joints(found.point_map, places[0])[0] - places[1], axis=1)
        error *= 100 * found.point_map.target.scale
        across = (
            100
            * found.point_map.target.scale
            * np.linalg.norm(np.diff(body(source, "female_old_heavy").positions[ends], axis=1)[:, 0], axis=1)
        )
        yield (
            f"{len(ends)} joints {source} -> {target}, another body",
            f"{error.mean():.2f} % of sqrt(area) on average, worst {error.max():.2f}; limbs are "
            f"{np.median(across):.1f} thick; {np.mean(error / across):.2f} of the limb",
        )


def binding() -> Iterator[Row]:
    """A cage bound to `base` as `.mhclo` in one identity, against what it is in the two others."""
    for cage in ("proxy741", "male1591", "female1605"):
        found = _found(cage, "base", "male_young", "male_young")
        source, count = found.source, found.target.control.n_vertices
        per_face = len(source.faces) and len(found.source_triangles) // len(source.faces)
        faces = np.repeat(source.refinement.finest.face_parents, per_face)[found.triangle[:count]]
        fitting = bind(found.target.control.positions, source.control, faces)
        lines = []
        for name in ("male_young", "female_old_heavy", "neutral"):
            error = np.linalg.norm(fitting.positions(body("base", name).positions) - body(cage, name).positions, axis=1)
            lines.append(f"{name} {100 * _surface(cage, name).operators.scale * error.mean():.3f}")
        yield f".mhclo of {cage} on base", "mean error, % of sqrt(area): " + ", ".join(lines)


PARTS: dict[str, Callable[[], Iterator[Row]]] = {
    "identity": identity,
    "back": back,
    "normals": normals_back,
    "shapes": shapes,
    "joints": joints,
    "rig": rig,
    "binding": binding,
}


def main() -> None:
    """Measure some parts."""
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", help=f"some of {', '.join(PARTS)}; all by default")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    for part in given.parts or PARTS:
        for what, measured in PARTS[part]():
            print(f"| {what} | {measured} |", flush=True)
            if given.out is not None:
                with given.out.open("a") as stream:
                    stream.write(json.dumps({"part": part, "what": what, "measured": measured}) + "\n")


if __name__ == "__main__":
    main()
