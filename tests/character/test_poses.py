"""Poses at a time, and poses brought together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from cagemap.character.poses import (
    MIN_BONE_ANGLE,
    MIN_POSE_ANGLE,
    aligned_pose,
    example_times,
    fit_rotation_and_scale,
    least_rotation,
    parent_transforms,
    pose_at,
    track_value,
    world_transforms,
)
from cagemap.character.retarget import bind_pose_difference, joint_pairs, retarget, retarget_all
from cagemap.character.values import Animation, Rig, Track
from cagemap.errors import ParameterError

from example_rigs import dance, person
from refusals import refuses

TIMES = np.array([0.0, 0.5, 2.0])
QUATERNIONS = Rotation.random(3, rng=np.random.default_rng(3)).as_quat()


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, 1)])
def test_rotations_are_interpolated_as_scipy_does(signs: tuple[int, int, int]) -> None:
    track = Track(0, "rotation", TIMES, QUATERNIONS * np.array(signs)[:, None])
    slerp = Slerp(TIMES, Rotation.from_quat(QUATERNIONS))
    for time in np.linspace(0, 2, 23):
        apart = Rotation.from_quat(track_value(track, time)) * slerp(time).inv()
        assert apart.magnitude() < 1e-7


def test_splines_steps_and_ends() -> None:
    from scipy.interpolate import CubicHermiteSpline

    rng = np.random.default_rng(4)
    keys = rng.standard_normal((3, 3, 3))
    spline = Track(0, "translation", TIMES, keys, "CUBICSPLINE")
    for left in (0, 1):  # scipy's spline has one slope a key, glTF's two
        slopes = np.stack([keys[left, 2], keys[left + 1, 0]])
        expected = CubicHermiteSpline(TIMES[left : left + 2], keys[left : left + 2, 1], slopes)
        for time in np.linspace(TIMES[left], TIMES[left + 1], 7):
            np.testing.assert_allclose(track_value(spline, time), expected(time), atol=1e-12)
    turning = Track(0, "rotation", TIMES, rng.standard_normal((3, 3, 4)), "CUBICSPLINE")
    np.testing.assert_allclose(np.linalg.norm(track_value(turning, 0.7)), 1)
    steps = Track(0, "scale", TIMES, keys[:, 0], "STEP")
    for time, key in ((-1.0, 0), (0.4999, 0), (0.5, 1), (1.9, 1), (2.0, 2), (9.0, 2)):
        np.testing.assert_array_equal(track_value(steps, time), keys[key, 0])
    linear = Track(0, "scale", TIMES, keys[:, 0])
    for time, key in ((TIMES[0] - 1.0, 0), (TIMES[-1] + 1.0, 2)):
        np.testing.assert_array_equal(track_value(linear, time), keys[key, 0])
    once = Track(0, "scale", TIMES[:1], keys[:1, 0])
    np.testing.assert_array_equal(track_value(once, 3.0), keys[0, 0])


def test_channels_replace_their_part_of_a_joint() -> None:
    rig = person()
    np.testing.assert_allclose(pose_at(rig, Animation("none", ()), 1.0), rig.bind, atol=1e-12)
    turn = Rotation.from_rotvec((0.0, 0.0, np.pi / 2))
    tracks = (Track(4, "rotation", TIMES[:1], turn.as_quat()[None]), Track(4, "scale", TIMES[:1], np.full((1, 3), 2.0)))
    local = parent_transforms(pose_at(rig, Animation("one", tracks), 0.0), rig.parents)
    np.testing.assert_allclose(local[4, :3, :3], 2 * turn.as_matrix().T, atol=1e-9)
    np.testing.assert_allclose(local[4, 3, :3], rig.local[4, 3, :3], atol=1e-9)
    np.testing.assert_allclose(np.delete(local, 4, axis=0), np.delete(rig.local, 4, axis=0), atol=1e-9)
    refuses(ParameterError, "another rig", pose_at, rig, Animation("far", (replace(tracks[0], joint=11),)), 0.0)


def test_an_animation_of_its_own_rig_stays_as_it_is() -> None:
    rig = person()
    animation = dance(rig, cubic=True)
    for before, after in zip(animation.tracks, retarget(animation, rig, rig).tracks, strict=True):
        np.testing.assert_allclose(after.values, before.values, atol=1e-9)


def test_a_rig_with_other_names_and_axes_moves_alike() -> None:
    source = person()
    names = {"Hips": "pelvis", "Spine": "spine_01", "Neck": "neck_01", "Head": "head", "LeftUpLeg": "thigh_l"}
    names |= {"LeftLeg": "calf_l", "LeftFoot": "foot_l", "LeftArm": "upperarm_l", "LeftForeArm": "lowerarm_l"}
    names |= {"LeftHand": "hand_l", "RightUpLeg": "thigh_r"}
    bind = source.bind.copy()
    bind[:, :3, :3] = Rotation.random(len(bind), rng=np.random.default_rng(8)).as_matrix()
    target = Rig(
        tuple(names[name] for name in source.names), source.parents, parent_transforms(bind, source.parents), bind
    )
    assert joint_pairs(source, target) == {joint: joint for joint in range(len(bind))}
    animation = dance(source)
    again = retarget(animation, source, target)
    for time in (0.0, 0.3, 2.0):
        before, after = pose_at(source, animation, time), pose_at(target, again, time)
        np.testing.assert_allclose(after[:, 3], before[:, 3], atol=1e-7)
        turns = [
            np.linalg.inv(rig.bind)[:, :3, :3] @ now[:, :3, :3] for rig, now in ((source, before), (target, after))
        ]
        np.testing.assert_allclose(turns[1], turns[0], atol=1e-7)


def test_scales_are_relative_to_the_bind_pose_and_follow_the_axes() -> None:
    source = person(one_frame=True)
    bind = source.bind.copy()
    bind[:, :3, :3] = 0.01 * np.roll(np.eye(3), 1, axis=0)  # joint axes z, x, y, and a unit of its own
    target = replace(source, bind=bind, local=parent_transforms(bind, source.parents))
    scales = np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 3.0]])
    animation = Animation("grow", tuple(Track(joint, "scale", TIMES[:2], scales) for joint in (0, 4)))
    again = retarget(animation, source, target)
    np.testing.assert_allclose(pose_at(target, again, 0.0), target.bind, atol=1e-9)
    factors = np.diag([1.0, 2.0, 3.0]) @ np.diag([1.0, 2.0, 3.0])
    found = np.linalg.inv(bind[4]) @ pose_at(target, again, 0.5)[4]
    np.testing.assert_allclose(found[:3, :3], factors, atol=1e-9)


def raised(rig: Rig, angle: float, name: str = "LeftArm", axis: int = 2) -> Rig:
    """The rig bound with its arm raised, or another joint turned."""
    local = parent_transforms(rig.bind, rig.parents)
    world = rig.bind.copy()
    for joint, parent in enumerate(rig.parents):
        world[joint] = local[joint] @ world[parent] if parent >= 0 else world[joint]
        if rig.names[joint] == name:
            turn = Rotation.from_rotvec(-angle * np.eye(3)[axis]).as_matrix()
            world[joint, :3, :3] = world[joint, :3, :3] @ turn
    return replace(rig, bind=world, local=parent_transforms(world, rig.parents))


def test_poses_come_together() -> None:
    low = person()
    high = raised(low, 0.8)
    assert np.linalg.norm(high.heads - low.heads, axis=1).max() > 0.3
    np.testing.assert_allclose(aligned_pose(low, high)[:, 3], high.bind[:, 3], atol=1e-9)
    np.testing.assert_allclose(aligned_pose(low, low), low.bind, atol=1e-9)
    # The whole rig turned: its pose stays, and it is not turned back.
    turn = Rotation.from_rotvec((0.0, 1.2, 0.0)).as_matrix()
    turned = high.bind.copy()
    turned[:, :3] = turned[:, :3] @ np.block([[turn, np.zeros((3, 1))], [np.zeros((1, 3)), 1]])
    turned[:, 3, :3] = turned[:, 3, :3] @ turn
    other = replace(high, bind=turned, local=parent_transforms(turned, high.parents))
    np.testing.assert_allclose(aligned_pose(low, other)[:, 3], high.bind[:, 3], atol=1e-9)
    refuses(ParameterError, "humanoid bones in common", aligned_pose, replace(low, names=tuple("abcdefghijk")), high)


def test_a_bent_back_is_a_pose_and_no_turned_rig() -> None:
    straight = person()
    bent = raised(straight, 0.9, "Spine", 0)
    np.testing.assert_allclose(aligned_pose(straight, bent)[:, 3], bent.bind[:, 3], atol=1e-9)


def test_a_spine_alone_does_not_say_that_a_rig_is_turned() -> None:
    """Joints of `quaternius_Pug.fbx`, and where a pig has them, which must not be turned over."""
    places = {
        "Hips": ((0, 1.58, -0.64), (-0.02, 2.91, -2.3)),
        "Torso": ((0, 1.56, -0.01), (-0.02, 3.06, -0.71)),
        "Neck": ((0, 2.0, 1.06), (-0.06, 3.28, 2.48)),
        "Head": ((0, 2.25, 1.39), (-0.02, 3.19, 3.49)),
        "FrontLowLeg.L": ((0.42, 0.66, 0.87), (1.2, 1.33, 1.93)),
        "FrontLowLeg.R": ((-0.44, 0.66, 0.87), (-1.24, 1.45, 1.92)),
    }
    binds = np.tile(np.eye(4), (2, len(places), 1, 1))
    binds[:, :, 3, :3] = np.array([*places.values()]).swapaxes(0, 1)
    parents = np.array([-1, 0, 1, 2, 1, 1])
    pug, pig = (Rig(tuple(places), parents, parent_transforms(bind, parents), bind) for bind in binds)
    turn, _ = fit_rotation_and_scale(pug, pig, {joint: joint for joint in range(len(places))})
    np.testing.assert_allclose(turn, np.eye(3), atol=0.3)


@pytest.mark.parametrize("bent_at", [0, 1, 2])
def test_a_spine_without_limbs_is_bent_or_turned_as_a_whole(bent_at: int) -> None:
    """A bust whose upper joints turn by one radian; all of them are another rig in the same pose."""
    heads = np.array([[0.0, height, 0.0] for height in (0.5, 1.5, 3.2, 5.5)])
    turn, bent = Rotation.from_rotvec([1.0, 0.0, 0.0]).as_matrix(), heads.copy()
    bent[bent_at:] = (bent[bent_at:] - heads[bent_at]) @ turn + heads[bent_at]
    binds, parents = np.tile(np.eye(4), (2, 4, 1, 1)), np.arange(-1, 3)
    binds[:, :, 3, :3] = heads, bent
    names = "hips", "spine", "neck", "head"
    straight, other = (Rig(names, parents, parent_transforms(bind, parents), bind) for bind in binds)
    found = fit_rotation_and_scale(straight, other, {joint: joint for joint in range(4)})[0]
    np.testing.assert_allclose(found, turn if bent_at == 0 else np.eye(3), atol=1e-6)
    posed = bind_pose_difference(other, straight)
    assert (posed is None) == (bent_at == 0)
    if posed is not None:
        np.testing.assert_allclose(posed[:, 3, :3], heads, atol=1e-6)


def test_bones_that_point_nearly_alike_stay_as_they_are() -> None:
    low = person()
    for angle, kept in ((0.9 * MIN_BONE_ANGLE, True), (1.1 * MIN_BONE_ANGLE, False)):
        assert np.allclose(aligned_pose(low, raised(low, angle)), low.bind) == kept


def test_animals_in_another_pose_come_together() -> None:
    """A fox that runs in its bind pose; one whose paws point elsewhere is another animal in the same pose."""
    low = replace(person(), names=("Hips", "Torso", "Neck", "Head", *"efghijk"))  # of limbs no humanoid names
    for angle, kept in ((0.9 * MIN_POSE_ANGLE, True), (1.1 * MIN_POSE_ANGLE, False)):
        high = raised(low, angle, "h")
        posed = aligned_pose(low, high)[:, 3]
        np.testing.assert_allclose(posed, low.bind[:, 3] if kept else high.bind[:, 3], atol=1e-9)
        animation = dance(low)
        (again,), posed_otherwise = retarget_all((animation,), low, high)
        assert posed_otherwise != kept
        if not kept:
            np.testing.assert_allclose(pose_at(high, again, 0.5)[:, 3], pose_at(low, animation, 0.5)[:, 3], atol=1e-7)


def test_a_rig_of_one_joint_has_one_pose() -> None:
    rig = Rig(("root",), np.array([-1]), np.eye(4)[None], np.eye(4)[None])
    np.testing.assert_array_equal(aligned_pose(rig, rig), rig.bind)


@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_animations_go_to_a_body_in_another_pose(angle: float) -> None:
    """An arm that is raised in the body's own pose is not raised twice."""
    low = person()
    high = raised(low, angle)
    animation = dance(low)
    (again,), posed_otherwise = retarget_all((animation,), low, high)
    assert posed_otherwise == (angle > 0)
    for time in (0.0, 0.5):
        np.testing.assert_allclose(pose_at(high, again, time)[:, 3], pose_at(low, animation, time)[:, 3], atol=1e-7)


def test_motion_is_relative_to_the_common_pose() -> None:
    low = person()
    high = raised(low, 0.8)
    animation = dance(low)
    again = retarget(animation, low, high, reference=aligned_pose(high, low))
    for time in (0.0, 0.5):
        np.testing.assert_allclose(pose_at(high, again, time)[:, 3], pose_at(low, animation, time)[:, 3], atol=1e-7)


def test_least_rotation() -> None:
    rng = np.random.default_rng(0)
    for start, end in [*rng.standard_normal((5, 2, 3)), ((0, 0, 2), (0, 0, -3)), ((1, 2, 3), (2, 4, 6))]:
        start, end = np.array(start, dtype=float), np.array(end, dtype=float)
        turn = least_rotation(start, end)
        np.testing.assert_allclose(start @ turn / np.linalg.norm(start), end / np.linalg.norm(end), atol=1e-12)
        angle = Rotation.from_matrix(turn).magnitude()
        np.testing.assert_allclose(np.cos(angle), start @ end / np.linalg.norm(start) / np.linalg.norm(end), atol=1e-9)
    np.testing.assert_array_equal(least_rotation(np.zeros(3), np.ones(3)), np.eye(3))


def test_worlds_and_parents_are_inverse() -> None:
    rig = person()
    np.testing.assert_allclose(world_transforms(rig.local, rig.parents), rig.bind, atol=1e-12)


def test_a_mirrored_rig_moves_like_its_copy_elsewhere() -> None:
    """Joints with negative scales, as below a mirrored node; the copy is turned, enlarged and moved as a whole."""
    rng = np.random.default_rng(1)
    local = np.tile(np.eye(4), (5, 1, 1))
    scales = np.array([-1.0, 2.0, -0.5, 1.0, -1.0])
    local[:, :3, :3] = Rotation.random(5, rng=rng).as_matrix() * scales[:, None, None]
    local[:, 3, :3] = rng.standard_normal((5, 3))
    parents = np.array([-1, 0, 1, 0, 3])
    rig = Rig(tuple("abcde"), parents, local, world_transforms(local, parents))
    change = np.eye(4)
    change[:3, :3], change[3, :3] = 2.0 * Rotation.from_euler("zyx", [0.4, 1.0, 2.0]).as_matrix(), [1.0, 2.0, 3.0]
    moved = local.copy()
    moved[0] = local[0] @ change
    copy = replace(rig, local=moved, bind=rig.bind @ change)
    animation = Animation("turn", tuple(Track(joint, "rotation", TIMES, QUATERNIONS) for joint in range(5)))
    expected = pose_at(rig, animation, 0.3) @ change
    np.testing.assert_allclose(pose_at(copy, retarget(animation, rig, copy), 0.3), expected, atol=1e-6)


def test_a_reference_of_another_rig_is_refused() -> None:
    rig = person()
    with pytest.raises(ParameterError, match=rf"^reference: expected one transform a joint \({len(rig.names)}, 4, 4\)"):
        retarget(dance(rig), rig, rig, reference=rig.bind[:3])


def test_example_times_lie_between_the_first_and_the_last_key() -> None:
    """A pose of one key does not count."""
    tracks = [
        Track(0, "rotation", times, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))
        for times in (
            np.array([10.0, 11.0]),
            np.array([10.5, 14.0]),
            np.zeros(1),
        )
    ]
    start, times = example_times(Animation("walk", tuple(tracks)))
    assert start == 10.0
    np.testing.assert_allclose(times, [11.0, 12.0, 13.0])
    np.testing.assert_array_equal(example_times(Animation("pose", (tracks[2],)))[1], 0.0)
