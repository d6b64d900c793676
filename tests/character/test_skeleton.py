"""A rig carried to another body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import cube
from scipy import sparse
from scipy.spatial.transform import Rotation

from cagemap.character.poses import parent_transforms, pose_at, world_transforms
from cagemap.character.retarget import retarget
from cagemap.character.skeleton import carry_rig, prop_joints
from cagemap.character.values import Part, Rig

from example_rigs import body_moved, dance, person

STILL = (1.0, np.eye(3), np.zeros(3))
MOVED = (2.5, Rotation.from_rotvec((0.4, -1.1, 0.7)).as_matrix(), np.array([3.0, -1.0, 2.0]))


def moved(transforms: np.ndarray, scale: float, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Joints of a body after it is scaled, turned and shifted; their own scales stay."""
    result = transforms.copy()
    result[:, :3, :3] = transforms[:, :3, :3] @ turn
    result[:, 3, :3] = scale * transforms[:, 3, :3] @ turn + shift
    return result


def stooping(rig: Rig) -> Rig:
    """The rig at rest in another pose than that of its bind matrices."""
    local = rig.local.copy()
    local[1, :3, :3] = local[1, :3, :3] @ Rotation.from_rotvec((0.5, 0.1, 0.0)).as_matrix()
    local[5, 3, :3] *= 1.1
    return replace(rig, local=local)


@pytest.mark.parametrize("rig", [person(), person(one_frame=True), stooping(person())])
@pytest.mark.parametrize("cubic", [False, True])
def test_rig_and_poses_move_with_the_body(rig: Rig, cubic: bool) -> None:
    carried = carry_rig(body_moved(*MOVED), rig)
    assert carried.names == rig.names
    np.testing.assert_array_equal(carried.parents, rig.parents)
    np.testing.assert_allclose(carried.bind, moved(rig.bind, *MOVED), rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        world_transforms(carried.local, carried.parents),
        moved(world_transforms(rig.local, rig.parents), *MOVED),
        rtol=0,
        atol=1e-8,
    )
    animation = dance(rig, cubic=cubic)
    again = retarget(animation, rig, carried)
    for time in (0.0, 0.2, 0.5, 1.3, 9.0):
        expected = moved(pose_at(rig, animation, time), *MOVED)
        np.testing.assert_allclose(pose_at(carried, again, time), expected, rtol=0, atol=1e-7)


def test_axes_along_bones_stay_along_bones() -> None:
    rig = person()
    bind = rig.bind.copy()
    for joint, child in ((4, 5), (5, 6), (7, 8)):  # the second axis of a joint points to its child
        along = rig.heads[child] - rig.heads[joint]
        along /= np.linalg.norm(along)
        across = np.cross(along, (0.3, 0.2, 1.0))
        across /= np.linalg.norm(across)
        bind[joint, :3, :3] = [across, along, np.cross(across, along)]
    rig = replace(rig, bind=bind, local=parent_transforms(bind, rig.parents))
    still, turned = body_moved(*STILL), body_moved(1.0, np.diag([1.4, 0.8, 1.0]), np.zeros(3))
    carried = carry_rig(replace(turned, images=still.images), rig)
    for joint, child in ((4, 5), (5, 6), (7, 8)):
        along = carried.heads[child] - carried.heads[joint]
        np.testing.assert_allclose(carried.bind[joint, 1, :3], along / np.linalg.norm(along), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(carried.bind[joint, :3, :3]), 1, atol=1e-12)
    np.testing.assert_allclose(world_transforms(carried.local, carried.parents), carried.bind, atol=1e-12)


def test_rigs_of_one_frame_keep_it() -> None:
    still, other = (
        body_moved(*STILL),
        body_moved(1.0, np.array([(1.4, 0.3, 0.0), (0.0, 0.8, 0.2), (0.0, 0.0, 1.0)]), np.zeros(3)),
    )
    carried = carry_rig(replace(other, images=still.images), person(one_frame=True))
    assert np.abs(carried.heads - person().heads).max() > 0.05
    np.testing.assert_array_equal(carried.bind[:, :3, :3], np.tile(np.eye(3), (len(carried.names), 1, 1)))


def test_a_rest_pose_has_the_directions_of_the_source_s_on_a_body_in_another_pose() -> None:
    """The bind poses of the arms differ by 27 degrees; the rest pose lowers the arm of the source."""
    rig = person()
    local = rig.local.copy()
    local[7, :3, :3] = local[7, :3, :3] @ Rotation.from_rotvec((0.0, 0.0, -0.6)).as_matrix()
    rig = replace(rig, local=local)
    still, taller = body_moved(*STILL), body_moved(1.0, np.diag([1.0, 3.0, 1.0]), np.zeros(3))
    carried = carry_rig(replace(taller, images=still.images), rig)

    def arm(world: np.ndarray) -> np.ndarray:
        along = world[8, 3, :3] - world[7, 3, :3]
        return along / np.linalg.norm(along)

    assert arm(rig.bind) @ arm(carried.bind) < np.cos(np.radians(25.0))
    at_rest = [arm(world_transforms(one.local, one.parents)) for one in (rig, carried)]
    np.testing.assert_allclose(at_rest[1], at_rest[0], atol=1e-8)


@pytest.mark.parametrize(("head", "is_inside"), [((1.0, 0.5, 0.2), True), ((9.0, 0.5, 0.2), False)])
def test_the_joint_of_a_rigid_prop_stays_at_its_place_in_the_prop(head: tuple[float, ...], is_inside: bool) -> None:
    prop = cube()
    prop = prop.with_positions(prop.positions - [-1.0, -0.5, 0.0])
    turn = 2.0 * Rotation.from_rotvec((0.4, -1.1, 0.7)).as_matrix()
    carried = Part("prop", prop.with_positions(prop.positions @ turn + 3.0))
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 3, :3] = head
    rig = Rig(("root", "prop"), np.array([-1, -1]), bind, bind)
    weights = sparse.csr_array(np.tile([0.0, 1.0], (prop.n_vertices, 1)))
    props = (Part("prop", prop, weights), carried), (Part("other", prop), carried)
    places = prop_joints(rig, props)
    assert list(places) == [1] * is_inside
    if is_inside:
        np.testing.assert_allclose(places[1], np.array(head) @ turn + 3.0)
        np.testing.assert_allclose(carry_rig(body_moved(*STILL), rig, places).heads[1], places[1])
