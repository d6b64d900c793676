"""Box-models the two creatures of the built-in example from their blueprints.

A spine of rings is skinned with quads from rump to muzzle; legs, ears and tail are extruded from holes left in it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from examples.creatures.blueprints import DEER, PONY, Blueprint, Patch
from examples.creatures.modelling import CHANNELS, Creature, Modeller
from examples.creatures.unwrap import unwrap

from cagemap.numerics.arrays import FloatArray

SIDES = ("L", "R")
PADDING = 8 / 1024
"""Least distance between texture islands, in units of the texture's side: two texels at 256."""


def pony() -> Creature:
    """Return the stocky creature: 12-sided body, 8-sided legs, a texture island for every part."""
    return build_creature(PONY)


def deer() -> Creature:
    """Return the slender creature: 8-sided body, 6-sided legs, the texture islands of its body split along the back."""
    return build_creature(DEER)


def build_creature(plan: Blueprint) -> Creature:
    """Box-model one creature and unwrap it."""
    creature = model_creature(plan)
    islands = [plan.islands.get(part.removesuffix("_L").removesuffix("_R"), part) for part in creature.parts]
    if plan.halves:
        x = np.add.reduceat(creature.mesh.positions[creature.mesh.face_indices, 0], creature.mesh.face_offsets[:-1])
        islands = [
            name + "RL"[int(side)] if name == "body" else name for name, side in zip(islands, x >= 0, strict=True)
        ]
    mesh = unwrap(creature.mesh, islands, creature.seams, padding=PADDING)
    return replace(creature, mesh=mesh)


def model_creature(plan: Blueprint) -> Creature:
    """Box-model one creature: spine, caps, then limbs, left and right together."""
    model = Modeller()
    spine = _spine(model, plan)
    landmarks = {}
    for name, (k, j) in plan.landmarks.items():
        landmarks[name] = spine[k][j]
        if name.endswith("_L"):
            landmarks[name[:-1] + "R"] = model.mirrored([spine[k][j]])[0]
    landmarks |= _rump(model, plan, spine[0])
    landmarks |= _muzzle(model, plan, spine[-1])
    landmarks |= _legs(model, plan, spine)
    landmarks |= _ears(model, plan, spine)
    return model.finish(plan.name, landmarks)


def shrinkage(n: int) -> float:
    """Return how much smaller than its n control points a Catmull-Clark tube is: (2 + cos(2 pi / n)) / 3."""
    return float((2 + np.cos(2 * np.pi / n)) / 3)


def _row(n: int, **values: float) -> FloatArray:
    """(n, 6) channels, constant over a ring."""
    row = np.zeros((n, len(CHANNELS)))
    for name, value in values.items():
        row[:, CHANNELS.index(name)] = value
    return row


def _spine(model: Modeller, plan: Blueprint) -> list[list[int]]:
    """Make the rings of the body and skin them, leaving holes for legs and ears."""
    n, table = plan.sides, plan.spine
    top, bottom = table[:, [1, 0]], table[:, [3, 2]]  # (k,2) as (y,z)
    middle = (top + bottom) / 2
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    half = np.arange(n // 2 + 1)
    cosine, sine = np.cos(2 * np.pi * half / n), np.sin(2 * np.pi * half / n)
    sine[-1] = 0.0  # exactly on the mirror plane
    rings = []
    for k in range(len(table)):
        width, egg = table[k, 4], table[k, 5]
        y, z = (middle[k] + (top[k] - bottom[k]) / 2 * cosine[:, None] / shrinkage(n)).T
        x = width * sine * (1 + egg * cosine) / shrinkage(n)
        order = np.concatenate([half, half[-2:0:-1]])
        sign = np.where(np.arange(n) > n // 2, -1.0, 1.0)
        values = _row(n, spine=length[k])
        values[:, CHANNELS.index("girth")] = cosine[order]
        points = np.stack([sign * x[order], y[order], z[order]], axis=1)
        rings.append([model.vertex(point, value) for point, value in zip(points, values, strict=True)])
    for k in range(len(rings) - 1):
        # A ring seen from the rump is a loop; the next one faces it, so the bridge runs backwards in k.
        holes = _holes(plan, k)
        for part, sides in _sections(plan, k).items():
            model.bridge(rings[k + 1], rings[k], part, skip=holes | (set(range(n)) - sides))
    chest, chin = plan.landmarks["chest"][0], plan.landmarks["chin"][0]
    model.seam([ring[n // 2] for ring in (rings if plan.halves else rings[chest : chin + 1])])
    if plan.halves:
        model.seam([ring[0] for ring in rings[: plan.landmarks["throat"][0] + 1]])
    return rings


def _sections(plan: Blueprint, k: int) -> dict[str, set[int]]:
    """Name the parts of the body between ring k and k + 1, with the sides that belong to each."""
    every = set(range(plan.sides))
    if k >= plan.landmarks["chest"][0]:
        beyond = [name for name in ("throat", "chin") if k >= plan.landmarks[name][0]]
        return {{"throat": "head", "chin": "muzzle"}[beyond[-1]] if beyond else "neck": every}
    if k == 0:
        return {"rump": every}
    below = set(range(plan.front_patch.j1, plan.sides - plan.front_patch.j1))
    return {"torso": every - below, "belly": below}


def _holes(plan: Blueprint, k: int) -> set[int]:
    """Return the faces after ring k that limbs replace, on both sides."""
    holes = set()
    for patch in (plan.front_patch, plan.hind_patch, plan.ear_patch):
        if patch.k0 <= k < patch.k1:
            left = range(patch.j0, patch.j1)
            holes |= set(left) | {plan.sides - 1 - j for j in left}
    return holes


def _loop(spine: list[list[int]], patch: Patch) -> list[int]:
    """Return the border of a patch as a loop: along j0 to the front, down, back along j1, up."""
    return (
        [spine[k][patch.j0] for k in range(patch.k0, patch.k1)]
        + [spine[patch.k1][j] for j in range(patch.j0, patch.j1)]
        + [spine[k][patch.j1] for k in range(patch.k1, patch.k0, -1)]
        + [spine[patch.k0][j] for j in range(patch.j1, patch.j0, -1)]
    )


def _cap_points(
    ring_top: FloatArray, ring_bottom: FloatArray, outward: FloatArray, bulge: float, rows: int
) -> FloatArray:
    """Return (rows, 3) points between top and bottom of a ring, bulging like a half ellipse."""
    share = np.arange(1, rows + 1) / (rows + 1)
    height = bulge * np.linalg.norm(ring_top - ring_bottom) / 2 * np.sqrt(1 - (2 * share - 1) ** 2)
    points = ring_top + share[:, None] * (ring_bottom - ring_top) + height[:, None] * outward
    points[:, 0] = 0.0
    return points


def _ring_ends(row: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return top, bottom and forward normal of a spine ring."""
    top, bottom = np.array([0.0, row[1], row[0]]), np.array([0.0, row[3], row[2]])
    up = (top - bottom) / np.linalg.norm(top - bottom)
    return top, bottom, np.cross([1.0, 0.0, 0.0], up)


def _rump(model: Modeller, plan: Blueprint, ring: list[int]) -> dict[str, int]:
    """Close the rear end and grow the tail from its top rows."""
    n, rows = plan.sides, plan.sides // 2 - 1
    top, bottom, forward = _ring_ends(plan.spine[0])
    middle = _cap_points(top, bottom, -forward, plan.rump_bulge, rows)
    values = _row(rows, spine=-plan.rump_bulge * float(np.linalg.norm(top - bottom)) / 2)
    values[:, CHANNELS.index("girth")] = np.linspace(1, -1, rows + 2)[1:-1]
    inner = model.grid_cap(ring, middle, values, "rump", skip=plan.tail_rows)
    loop = [*ring[: plan.tail_rows + 1], inner[plan.tail_rows - 1], *ring[n - plan.tail_rows :]]
    rings = _tail_rings(plan, len(loop))
    share = np.arange(1, len(rings) + 1) / (len(rings) + 1)
    base = {"spine": model.channel(ring, "spine")}
    channels = np.stack([_row(len(loop), tail=t, **base) for t in share])
    channels[:, :, CHANNELS.index("girth")] = np.cos(2 * np.pi * np.arange(len(loop)) / len(loop))
    loops = model.limb(loop, rings, channels, "tail")
    tip = model.fan(loops[-1], (0.0, *plan.tail_tip), _row(1, tail=1.0, **base)[0], "tail")
    if plan.halves:
        model.seam([*inner[plan.tail_rows - 1 :], ring[n // 2]])
    model.seam([inner[plan.tail_rows - 1], *(following[len(loop) // 2] for following in loops), tip])
    return {"tail_base": ring[0], "tail_tip": tip}


def _tail_rings(plan: Blueprint, n: int) -> FloatArray:
    """(r, n, 3) rings of the tail, the first point of each on its upper side."""
    y, z, across, up, angle = (plan.tail / [1, 1, shrinkage(n), shrinkage(n), 1]).T[:, :, None]
    turn = 2 * np.pi * np.minimum(np.arange(n), n - np.arange(n)) / n
    side = np.where(np.arange(n) > n // 2, -1.0, 1.0) * np.where(np.arange(n) % (n // 2) == 0, 0.0, 1.0)
    below = np.radians(angle)
    height = up * np.cos(turn)
    return np.stack([across * np.sin(turn) * side, y + height * np.cos(below), z - height * np.sin(below)], axis=2)


def _muzzle(model: Modeller, plan: Blueprint, ring: list[int]) -> dict[str, int]:
    """Close the front end."""
    n, rows = plan.sides, plan.sides // 2 - 1
    loop = [ring[0], *ring[:0:-1]]
    top, bottom, forward = _ring_ends(plan.spine[-1])
    end = model.channel(ring, "spine") + plan.muzzle_bulge * float(np.linalg.norm(top - bottom)) / 2
    if plan.pentagon_muzzle:
        point = _cap_points(top, bottom, forward, plan.muzzle_bulge, 1)[0]
        nose = model.vertex(point, _row(1, spine=end)[0])
        quarter = n // 4
        right = [*loop[: quarter + 2], nose]
        lower = [nose, *loop[quarter + 1 : n // 2 + 1]]
        for face in (right, lower):
            model.face(face, "muzzle")
            model.face(model.mirrored(face), "muzzle")
        model.seam([ring[n // 2], nose])
        return {"nose_tip": nose}
    values = _row(rows, spine=end)
    values[:, CHANNELS.index("girth")] = np.linspace(1, -1, rows + 2)[1:-1]
    inner = model.grid_cap(loop, _cap_points(top, bottom, forward, plan.muzzle_bulge, rows), values, "muzzle")
    return {"nose_tip": inner[rows // 2]}


def _legs(model: Modeller, plan: Blueprint, spine: list[list[int]]) -> dict[str, int]:
    """Extrude the four legs down to their soles."""
    landmarks = {}
    for place, patch, table, joint in (
        ("front", plan.front_patch, plan.front_leg, ("knee", plan.knee)),
        ("hind", plan.hind_patch, plan.hind_leg, ("hock", plan.hock)),
    ):
        loop = _loop(spine, patch)
        n, outer = len(loop), (patch.k1 - patch.k0) // 2
        turn = np.pi / 2 - 2 * np.pi * (np.arange(n) - outer) / n  # 0 looks forward, pi/2 away from the body
        x, y, z, across, along = (table / [1, 1, 1, shrinkage(n), shrinkage(n)]).T[:, :, None]
        rings = np.stack(
            [x + across * np.sin(turn), np.broadcast_to(y, (len(table), n)), z + along * np.cos(turn)], axis=2
        )
        share = np.arange(1, len(table) + 1) / len(table)
        base = {name: model.channel(loop, name) for name in ("spine", "girth")}
        channels = np.stack([_row(n, leg=t, **base) for t in share])
        for side in SIDES:
            sign = 1.0 if side == "L" else -1.0
            flip = slice(None) if side == "L" else slice(None, None, -1)
            here = loop if side == "L" else model.mirrored(loop)
            part = f"leg_{place}_{side}"
            loops = model.limb(here, (rings * [sign, 1, 1])[:, flip], channels[:, flip], part)
            model.rename(n, f"sole_{place}_{side}")
            toe = outer if side == "L" else n - 1 - outer
            inner = (toe + n // 2) % n
            _sole(model, plan, [*loops[-1][toe:], *loops[-1][:toe]], f"sole_{place}_{side}")
            model.seam([here[inner], *(following[inner] for following in loops[:-1])])
            landmarks[f"{joint[0]}_{side}"] = loops[joint[1]][toe]
            landmarks[f"hoof_{place}_{side}"] = loops[-2][toe]
    return landmarks


def _sole(model: Modeller, plan: Blueprint, loop: list[int], part: str) -> None:
    """Close a leg by one polygon, or by two quads that meet on the line from the loop's first vertex across."""
    if plan.polygon_soles:
        model.face(loop, part)
        return
    half = len(loop) // 2
    model.face(loop[: half + 1], part)
    model.face([loop[half], *loop[half + 1 :], loop[0]], part)


def _ears(model: Modeller, plan: Blueprint, spine: list[list[int]]) -> dict[str, int]:
    """Extrude both ears; the opening looks along ``plan.ear_front``."""
    loop = _loop(spine, plan.ear_patch)
    n, table = len(loop), plan.ear
    axis = plan.ear_tip - table[0, :3]
    axis = axis / np.linalg.norm(axis)
    front = plan.ear_front - (plan.ear_front @ axis) * axis
    front = front / np.linalg.norm(front)
    out = np.cross(axis, front)
    # Border order: inner back, then the front from inside to outside, then the back from outside to inside.
    cells = n // 2 - 1
    across = np.concatenate([[-1.0], np.linspace(-1, 1, cells + 1), np.linspace(1, -1, cells + 1)[:-1]])
    along = np.concatenate([[-1.0], np.ones(cells + 1), -np.ones(cells)])
    inside = np.where((along > 0) & (np.abs(across) < 1), 1.0, 0.0)
    width, depth, cup = (table[:, 3:6, None] / [[1.0], [1.0], [1.0]]).transpose(1, 0, 2)
    shift = (along * depth - inside * cup)[:, :, None] * front
    rings = table[:, None, :3] + (across * width)[:, :, None] * out + shift
    share = np.arange(1, len(table) + 1) / (len(table) + 1)
    base = {name: model.channel(loop, name) for name in ("spine", "girth")}
    channels = np.stack([_row(n, ear=t, **base) for t in share])
    channels[:, :, CHANNELS.index("cup")] = along
    landmarks = {}
    for side in SIDES:
        sign = 1.0 if side == "L" else -1.0
        flip = slice(None) if side == "L" else slice(None, None, -1)
        here = loop if side == "L" else model.mirrored(loop)
        loops = model.limb(here, (rings * [sign, 1, 1])[:, flip], channels[:, flip], f"ear_{side}")
        tip = model.fan(loops[-1], plan.ear_tip * [sign, 1, 1], _row(1, ear=1.0, **base)[0], f"ear_{side}")
        back = n - 1 if side == "L" else 0
        model.seam([here[back], *(following[back] for following in loops), tip])
        landmarks[f"ear_tip_{side}"] = tip
    return landmarks
