"""Humanoid bones: names of joints in common rigs, as VRM 1.0 names them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import chain, product

import numpy as np

from cagemap.character.values import Rig
from cagemap.numerics.arrays import IndexArray

SIDES = ("left", "right")

# How each convention writes left and right in place of {}.
CONVENTIONS: Mapping[str, tuple[str, str]] = {
    "VRM 0.x": ("left", "right"),
    "Mixamo": ("Left", "Right"),
    "Rigify": ("L", "R"),
    "MakeHuman": ("L", "R"),
    "Unreal": ("l", "r"),
    "Character Creator": ("L", "R"),
    "Blender": ("L", "R"),
    "Khronos RiggedFigure": ("L", "R"),
    "Khronos CesiumMan": ("L", "R"),
}

# One row a bone: VRM 1.0 name, VRM parent, then its name in each convention; "=" as in VRM 1.0, "-" none, "|" between
# names of which the first that is there counts, "/" between left and right. Case, separators, a namespace such as
# "mixamorig:" and Rigify's "DEF-" do not matter.
_ROWS = """
hips                  -                     =                    Hips           spine           root           pelvis        CC_Base_Hip          Hips|Pelvis|Hip                   torso_joint_1   torso_joint_1
spine                 hips                  =                    Spine          spine.001       spine05        spine_01      CC_Base_Waist        Spine|Abdomen                     torso_joint_2   torso_joint_2
chest                 spine                 =                    Spine1         spine.002       spine03        spine_02      CC_Base_Spine01      Chest|Torso|Spine1                torso_joint_3   torso_joint_3
upperChest            chest                 =                    Spine2         spine.003       spine01        spine_03      CC_Base_Spine02      UpperChest|Spine2                 -               -
neck                  upperChest            =                    Neck           spine.004       neck01         neck_01       CC_Base_NeckTwist01  Neck                              neck_joint_1    neck_joint_1
head                  neck                  =                    Head           spine.006       head           head          CC_Base_Head         Head                              neck_joint_2    neck_joint_2
jaw                   head                  =                    Jaw            jaw             jaw            jaw           CC_Base_JawRoot      Jaw                               -               -
{}Eye                 head                  =                    {}Eye          eye.{}          eye.{}         eye_{}        CC_Base_{}_Eye       Eye.{}                            -               -
{}UpperLeg            hips                  =                    {}UpLeg        thigh.{}        upperleg01.{}  thigh_{}      CC_Base_{}_Thigh     UpperLeg.{}|Thigh.{}              leg_joint_{}_1  leg_joint_{}_1
{}LowerLeg            {}UpperLeg            =                    {}Leg          shin.{}         lowerleg01.{}  calf_{}       CC_Base_{}_Calf      LowerLeg.{}|Shin.{}               leg_joint_{}_2  leg_joint_{}_2
{}Foot                {}LowerLeg            =                    {}Foot         foot.{}         foot.{}        foot_{}       CC_Base_{}_Foot      Foot.{}                           leg_joint_{}_3  leg_joint_{}_3
{}Toes                {}Foot                =                    {}ToeBase      toe.{}          toe2-1.{}      ball_{}       CC_Base_{}_ToeBase   Toes.{}|Toe.{}                    leg_joint_{}_5  leg_joint_{}_5
{}Shoulder            upperChest            =                    {}Shoulder     shoulder.{}     clavicle.{}    clavicle_{}   CC_Base_{}_Clavicle  Shoulder.{}|Clavicle.{}           -               -
{}UpperArm            {}Shoulder            =                    {}Arm          upper_arm.{}    upperarm01.{}  upperarm_{}   CC_Base_{}_Upperarm  UpperArm.{}|Arm.{}                arm_joint_{}_1  arm_joint_L__4_/arm_joint_R
{}LowerArm            {}UpperArm            =                    {}ForeArm      forearm.{}      lowerarm01.{}  lowerarm_{}   CC_Base_{}_Forearm   LowerArm.{}|ForeArm.{}            arm_joint_{}_2  arm_joint_L__3_/arm_joint_R__2_
{}Hand                {}LowerArm            =                    {}Hand         hand.{}         wrist.{}       hand_{}       CC_Base_{}_Hand      Hand.{}|Palm.{}                   arm_joint_{}_3  arm_joint_L__2_/arm_joint_R__3_
{}ThumbMetacarpal     {}Hand                {}ThumbProximal      {}HandThumb1   thumb.01.{}     finger1-1.{}   thumb_01_{}   CC_Base_{}_Thumb1    Thumb1.{}|Thumb.01.{}             -               -
{}ThumbProximal       {}ThumbMetacarpal     {}ThumbIntermediate  {}HandThumb2   thumb.02.{}     finger1-2.{}   thumb_02_{}   CC_Base_{}_Thumb2    Thumb2.{}|Thumb.02.{}             -               -
{}ThumbDistal         {}ThumbProximal       =                    {}HandThumb3   thumb.03.{}     finger1-3.{}   thumb_03_{}   CC_Base_{}_Thumb3    Thumb3.{}|Thumb.03.{}             -               -
{}IndexProximal       {}Hand                =                    {}HandIndex1   f_index.01.{}   finger2-1.{}   index_01_{}   CC_Base_{}_Index1    Index1.{}|Index.01.{}             -               -
{}IndexIntermediate   {}IndexProximal       =                    {}HandIndex2   f_index.02.{}   finger2-2.{}   index_02_{}   CC_Base_{}_Index2    Index2.{}|Index.02.{}             -               -
{}IndexDistal         {}IndexIntermediate   =                    {}HandIndex3   f_index.03.{}   finger2-3.{}   index_03_{}   CC_Base_{}_Index3    Index3.{}|Index.03.{}             -               -
{}MiddleProximal      {}Hand                =                    {}HandMiddle1  f_middle.01.{}  finger3-1.{}   middle_01_{}  CC_Base_{}_Mid1      Middle1.{}|Middle.01.{}           -               -
{}MiddleIntermediate  {}MiddleProximal      =                    {}HandMiddle2  f_middle.02.{}  finger3-2.{}   middle_02_{}  CC_Base_{}_Mid2      Middle2.{}|Middle.02.{}           -               -
{}MiddleDistal        {}MiddleIntermediate  =                    {}HandMiddle3  f_middle.03.{}  finger3-3.{}   middle_03_{}  CC_Base_{}_Mid3      Middle3.{}|Middle.03.{}           -               -
{}RingProximal        {}Hand                =                    {}HandRing1    f_ring.01.{}    finger4-1.{}   ring_01_{}    CC_Base_{}_Ring1     Ring1.{}|Ring.01.{}               -               -
{}RingIntermediate    {}RingProximal        =                    {}HandRing2    f_ring.02.{}    finger4-2.{}   ring_02_{}    CC_Base_{}_Ring2     Ring2.{}|Ring.02.{}               -               -
{}RingDistal          {}RingIntermediate    =                    {}HandRing3    f_ring.03.{}    finger4-3.{}   ring_03_{}    CC_Base_{}_Ring3     Ring3.{}|Ring.03.{}               -               -
{}LittleProximal      {}Hand                =                    {}HandPinky1   f_pinky.01.{}   finger5-1.{}   pinky_01_{}   CC_Base_{}_Pinky1    Pinky1.{}|Pinky.01.{}|Little1.{}  -               -
{}LittleIntermediate  {}LittleProximal      =                    {}HandPinky2   f_pinky.02.{}   finger5-2.{}   pinky_02_{}   CC_Base_{}_Pinky2    Pinky2.{}|Pinky.02.{}|Little2.{}  -               -
{}LittleDistal        {}LittleIntermediate  =                    {}HandPinky3   f_pinky.03.{}   finger5-3.{}   pinky_03_{}   CC_Base_{}_Pinky3    Pinky3.{}|Pinky.03.{}|Little3.{}  -               -
"""  # noqa: E501

# Prefixes that say nothing of the bone: of a namespace or object, of Rigify's deforming bones, of Khronos' samples.
_PREFIX = re.compile(r"^.*[:|/]|^(DEF[-_]|Skeleton_)")
# Sides in names: words, or a letter of its own.
_SIDE_WORD = re.compile(r"[Ll]eft|[Rr]ight|LEFT|RIGHT|(?<![A-Za-z])[LlRr](?![A-Za-z])")
_SIDE_PAIRS = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("l", "r"), ("L", "R"))
_OTHER_SIDE = {one: other for pair in _SIDE_PAIRS for one, other in (pair, pair[::-1])}
# Numbers that some exporters append to every name.
_SUFFIX = re.compile(r"_\d+$")


def _plain(name: str) -> str:
    """A name without prefix, separators and case."""
    return re.sub(r"[^a-z0-9]", "", _PREFIX.sub("", _PREFIX.sub("", name)).lower())


def _tables() -> tuple[dict[str, str], dict[str, dict[str, tuple[str, ...]]]]:
    """VRM parents, and for each convention plain names of each VRM bone, in order of preference."""
    parents: dict[str, str] = {}
    tables: dict[str, dict[str, tuple[str, ...]]] = {name: {} for name in ("VRM 1.0", *CONVENTIONS)}
    for row in _ROWS.strip().splitlines():
        bone, parent, *cells = row.split()
        for side in range(2 if "{}" in bone else 1):
            name = bone.format(SIDES[side])
            parents[name] = parent.format(SIDES[side])
            tables["VRM 1.0"][name] = (_plain(name),)
            for (convention, words), cell in zip(CONVENTIONS.items(), cells, strict=True):
                if cell != "-":
                    one = cell.replace("=", bone).split("/")[side if "/" in cell else 0]
                    tables[convention][name] = tuple(_plain(text.format(words[side])) for text in one.split("|"))
    return parents, tables


PARENTS, TABLES = _tables()


def humanoid_names(rig: Rig) -> dict[str, int]:
    """Joints of a rig that are humanoid bones, by their VRM 1.0 names.

    Of all naming conventions the one counts that names the most joints. Joints that hang on others than their bones do
    are left out.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    dict of str to int
        Empty where no convention knows the joints.
    """
    given = [tuple(_plain(name) for name in rig.names)]
    given.append(tuple(_plain(_SUFFIX.sub("", name)) for name in rig.names))
    found = (_named(rig, names, table) for names, table in product(given, TABLES.values()))
    return max(chain([{}], found), key=len)


def _named(rig: Rig, names: tuple[str, ...], table: Mapping[str, tuple[str, ...]]) -> dict[str, int]:
    """Joints that one table names, as far as their parents agree with it."""
    joint_of = {name: joint for joint, name in reversed(list(enumerate(names)))}
    chosen = {bone: next((joint_of[name] for name in known if name in joint_of), -1) for bone, known in table.items()}
    bone_of = {joint: bone for bone, joint in chosen.items() if joint >= 0}
    kept: dict[int, str] = {}
    for joint in sorted(bone_of):  # parents stand before children
        above = int(rig.parents[joint])
        while above >= 0 and above not in kept:
            above = int(rig.parents[above])
        if above < 0 or kept[above] in bones_above(bone_of[joint]):
            kept[joint] = bone_of[joint]
    return {bone: joint for bone, joint in chosen.items() if kept.get(joint) == bone}


def mirrored_joints(names: Sequence[str]) -> IndexArray:
    """Joint on the other side (j,) of each joint, by left and right in the names; itself where none is."""
    numbers = {name: joint for joint, name in enumerate(names)}
    others = [_SIDE_WORD.sub(lambda word: _OTHER_SIDE[word.group()], name, count=1) for name in names]
    return np.array([numbers.get(other, joint) for joint, other in enumerate(others)], dtype=np.int64)


def bones_above(bone: str) -> list[str]:
    """VRM bones that a VRM bone hangs on, the nearest first."""
    above = []
    while (bone := PARENTS[bone]) != "-":
        above.append(bone)
    return above
