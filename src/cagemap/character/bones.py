"""Humanoid bones: their VRM 1.0 names and the names of their joints in common rigs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import chain, product

import numpy as np

from cagemap.character.values import Rig
from cagemap.numerics.arrays import IndexArray

BODY_SIDES = ("left", "right")

# Left and right in each convention, for {} below.
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

# One row a bone: VRM 1.0 name, VRM parent, its name in each convention. "=": the VRM 1.0 name; "-": none;
# "|": first present; "/": left and right differ. Case, separators, namespaces and "DEF-" are ignored.
_BONE_TABLE = """
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

# Prefixes without meaning: namespaces and objects, Rigify's deforming bones, Khronos' samples.
_PREFIX = re.compile(r"^.*[:|/]|^(DEF[-_]|Skeleton_)")
# Sides in names: a word, a single letter, or one before or after a word in camel case (lThigh, ThighL).
_SIDE_WORD = re.compile(
    r"[Ll]eft|[Rr]ight|LEFT|RIGHT|(?<![A-Za-z])[LlRr](?![A-Za-z])|(?<![A-Za-z])[lr](?=[A-Z])|(?<=[a-z])[LR](?![A-Za-z])"
)
_SIDE_PAIRS = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("l", "r"), ("L", "R"))
_OPPOSITE_SIDE = {spelling: opposite for pair in _SIDE_PAIRS for spelling, opposite in (pair, pair[::-1])}
# Numbers that some exporters append to all names.
_SUFFIX = re.compile(r"_\d+$")


def _bare_name(name: str) -> str:
    """A name in lower case without prefix and separators."""
    return re.sub(r"[^a-z0-9]", "", _PREFIX.sub("", _PREFIX.sub("", name)).lower())


def _read_rows() -> tuple[dict[str, str], dict[str, dict[str, tuple[str, ...]]]]:
    """VRM parents; and bare names of each VRM bone by convention, in order of preference."""
    parents: dict[str, str] = {}
    tables: dict[str, dict[str, tuple[str, ...]]] = {name: {} for name in ("VRM 1.0", *CONVENTIONS)}
    for row in _BONE_TABLE.strip().splitlines():
        bone, parent, *cells = row.split()
        for side in range(2 if "{}" in bone else 1):
            name = bone.format(BODY_SIDES[side])
            parents[name] = parent.format(BODY_SIDES[side])
            tables["VRM 1.0"][name] = (_bare_name(name),)
            for (convention, words), cell in zip(CONVENTIONS.items(), cells, strict=True):
                if cell != "-":
                    spelling = cell.replace("=", bone).split("/")[side if "/" in cell else 0]
                    tables[convention][name] = tuple(
                        _bare_name(text.format(words[side])) for text in spelling.split("|")
                    )
    return parents, tables


BONE_PARENTS, BONE_NAMES = _read_rows()


def humanoid_joints(rig: Rig) -> dict[str, int]:
    """Joints of a rig that are humanoid bones, by VRM 1.0 name.

    The naming convention that names the most joints is used. Joints whose parents contradict the bones' parents are
    left out.

    Returns
    -------
    dict of str to int
        Empty where no convention knows the joints.
    """
    name_lists = [tuple(_bare_name(name) for name in rig.names)]
    name_lists.append(tuple(_bare_name(_SUFFIX.sub("", name)) for name in rig.names))
    matches = (_matched_joints(rig, names, table) for names, table in product(name_lists, BONE_NAMES.values()))
    return max(chain([{}], matches), key=len)


def _matched_joints(rig: Rig, names: tuple[str, ...], table: Mapping[str, tuple[str, ...]]) -> dict[str, int]:
    """Joints that a table names and whose parents agree with the bones' parents."""
    joint_of = {name: joint for joint, name in reversed(list(enumerate(names)))}
    joint_of_bone = {
        bone: next((joint_of[name] for name in candidates if name in joint_of), -1)
        for bone, candidates in table.items()
    }
    bone_of = {joint: bone for bone, joint in joint_of_bone.items() if joint >= 0}
    accepted: dict[int, str] = {}
    for joint in sorted(bone_of):  # parents stand before children
        ancestor = int(rig.parents[joint])
        while ancestor >= 0 and ancestor not in accepted:
            ancestor = int(rig.parents[ancestor])
        if ancestor < 0 or accepted[ancestor] in ancestor_bones(bone_of[joint]):
            accepted[joint] = bone_of[joint]
    return {bone: joint for bone, joint in joint_of_bone.items() if accepted.get(joint) == bone}


def mirrored_joints(names: Sequence[str]) -> IndexArray:
    """(j,) joint on the other side, by left and right in names; else itself."""
    numbers = {name: joint for joint, name in enumerate(names)}
    mirrored_names = [_SIDE_WORD.sub(lambda word: _OPPOSITE_SIDE[word.group()], name, count=1) for name in names]
    return np.array([numbers.get(opposite, joint) for joint, opposite in enumerate(mirrored_names)], dtype=np.int64)


def ancestor_bones(bone: str) -> list[str]:
    """VRM bones above a VRM bone, its parent first."""
    ancestors = []
    while (bone := BONE_PARENTS[bone]) != "-":
        ancestors.append(bone)
    return ancestors
