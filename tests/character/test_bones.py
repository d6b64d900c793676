"""Humanoid bones by the names of common rigs."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from cagemap.character.bones import (
    BONE_NAMES,
    BONE_PARENTS,
    CONVENTIONS,
    ancestor_bones,
    humanoid_joints,
    mirrored_joints,
)
from cagemap.character.values import Rig
from cagemap.mesh.parts import passenger_word

# Names and parents as the programs write them.
REAL = {
    "mixamorig:Hips": ("", "hips"),
    "mixamorig:Spine": ("mixamorig:Hips", "spine"),
    "mixamorig:Spine1": ("mixamorig:Spine", "chest"),
    "mixamorig:Spine2": ("mixamorig:Spine1", "upperChest"),
    "mixamorig:LeftShoulder": ("mixamorig:Spine2", "leftShoulder"),
    "mixamorig:LeftArm": ("mixamorig:LeftShoulder", "leftUpperArm"),
    "mixamorig:LeftForeArm": ("mixamorig:LeftArm", "leftLowerArm"),
    "mixamorig:LeftHand": ("mixamorig:LeftForeArm", "leftHand"),
    "mixamorig:LeftHandThumb1": ("mixamorig:LeftHand", "leftThumbMetacarpal"),
    "mixamorig:RightUpLeg": ("mixamorig:Hips", "rightUpperLeg"),
    "mixamorig:RightLeg": ("mixamorig:RightUpLeg", "rightLowerLeg"),
    "mixamorig:RightToeBase": ("mixamorig:RightLeg", "rightToes"),
}
RIGS = {
    "Mixamo": REAL,
    "Mixamo by Sketchfab": {f"{name}_{k:02d}": v for k, (name, v) in enumerate(REAL.items(), start=9)},
    "Rigify": {
        "DEF-spine": ("", "hips"),
        "DEF-spine.001": ("DEF-spine", "spine"),
        "DEF-spine.003": ("DEF-spine.001", "upperChest"),
        "DEF-spine.006": ("DEF-spine.003", "head"),
        "DEF-thigh.L": ("DEF-spine", "leftUpperLeg"),
        "DEF-thigh.L.001": ("DEF-thigh.L", ""),
        "DEF-shin.L": ("DEF-thigh.L.001", "leftLowerLeg"),
        "DEF-upper_arm.R": ("DEF-spine.003", "rightUpperArm"),
        "DEF-f_index.01.R": ("DEF-upper_arm.R", "rightIndexProximal"),
    },
    "Unreal": {
        "root": ("", ""),
        "pelvis": ("root", "hips"),
        "spine_01": ("pelvis", "spine"),
        "clavicle_l": ("spine_01", "leftShoulder"),
        "upperarm_l": ("clavicle_l", "leftUpperArm"),
        "upperarm_twist_01_l": ("upperarm_l", ""),
        "lowerarm_l": ("upperarm_l", "leftLowerArm"),
        "thigh_r": ("pelvis", "rightUpperLeg"),
        "calf_r": ("thigh_r", "rightLowerLeg"),
        "ball_r": ("calf_r", "rightToes"),
    },
    "Character Creator": {
        "CC_Base_BoneRoot": ("", ""),
        "CC_Base_Hip": ("CC_Base_BoneRoot", "hips"),
        "CC_Base_Pelvis": ("CC_Base_Hip", ""),
        "CC_Base_L_Thigh": ("CC_Base_Pelvis", "leftUpperLeg"),
        "CC_Base_L_Calf": ("CC_Base_L_Thigh", "leftLowerLeg"),
        "CC_Base_Waist": ("CC_Base_Hip", "spine"),
        "CC_Base_R_Upperarm": ("CC_Base_Waist", "rightUpperArm"),
        "CC_Base_R_Mid1": ("CC_Base_R_Upperarm", "rightMiddleProximal"),
    },
    "Quaternius": {
        "Bone": ("", ""),
        "Hips": ("Bone", "hips"),
        "Abdomen": ("Hips", "spine"),
        "Torso": ("Abdomen", "chest"),
        "UpperArm.L": ("Torso", "leftUpperArm"),
        "LowerArm.L": ("UpperArm.L", "leftLowerArm"),
        "LowerLeg.R_end": ("Hips", ""),
    },
    "CesiumMan": {
        "Skeleton_torso_joint_1": ("", "hips"),
        "Skeleton_torso_joint_2": ("Skeleton_torso_joint_1", "spine"),
        "torso_joint_3": ("Skeleton_torso_joint_2", "chest"),
        "Skeleton_arm_joint_L__4_": ("torso_joint_3", "leftUpperArm"),
        "Skeleton_arm_joint_L__3_": ("Skeleton_arm_joint_L__4_", "leftLowerArm"),
        "Skeleton_arm_joint_R": ("torso_joint_3", "rightUpperArm"),
        "Skeleton_arm_joint_R__2_": ("Skeleton_arm_joint_R", "rightLowerArm"),
        "leg_joint_L_1": ("Skeleton_torso_joint_1", "leftUpperLeg"),
        "leg_joint_L_5": ("leg_joint_L_1", "leftToes"),
    },
}


def rig_of(names: list[str], parents: list[str]) -> Rig:
    still = np.tile(np.eye(4), (len(names), 1, 1))
    return Rig(tuple(names), np.array([names.index(one) if one else -1 for one in parents]), still, still)


@pytest.mark.parametrize("convention", RIGS)
def test_real_names_are_known(convention: str) -> None:
    rows = RIGS[convention]
    names = list(rows)
    if convention == "Mixamo by Sketchfab":
        short = {name.rsplit("_", 1)[0]: name for name in names}
        parents = [short.get(parent, "") for parent, _ in rows.values()]
    else:
        parents = [parent for parent, _ in rows.values()]
    found = humanoid_joints(rig_of(names, parents))
    assert {bone: names[joint] for bone, joint in found.items()} == {
        bone: name for name, (_, bone) in rows.items() if bone
    }


@pytest.mark.parametrize("convention", ["VRM 1.0", *CONVENTIONS])
def test_every_name_of_a_table_is_its_bone(convention: str) -> None:
    table = BONE_NAMES[convention]
    names = [known[0] for known in table.values()]
    assert len(set(names)) == len(names)
    nearest = {bone: next((above for above in ancestor_bones(bone) if above in table), "") for bone in table}
    parents = [table[above][0] if above else "" for above in nearest.values()]
    assert humanoid_joints(rig_of(names, parents)) == {bone: joint for joint, bone in enumerate(table)}


def test_joints_on_wrong_parents_and_unknown_ones_are_left_out() -> None:
    names = ["Hips", "Spine", "LeftUpLeg", "LeftFoot", "tail"]
    assert set(humanoid_joints(rig_of(names, ["", "Hips", "Hips", "Spine", "Hips"]))) == {
        "hips",
        "spine",
        "leftUpperLeg",
    }
    assert humanoid_joints(rig_of(["b_Tail01", "b_Tail02"], ["", "b_Tail01"])) == {}


def test_joints_of_the_other_side() -> None:
    names = ["hips", "LeftArm", "RightArm", "CC_Base_L_Thigh", "CC_Base_R_Thigh", "calf_r", "calf_l", "toe.L", "Lid"]
    assert mirrored_joints(names).tolist() == [0, 2, 1, 4, 3, 6, 5, 7, 8]
    assert mirrored_joints(["finger1-1.L", "spine", "finger1-1.R"]).tolist() == [2, 1, 0]
    camel = ["lThigh", "rThigh", "rig:rFoot", "rig:lFoot", "HandR", "HandL", "lid", "Tail"]
    assert mirrored_joints(camel).tolist() == [1, 0, 3, 2, 5, 4, 6, 7]


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("anybody", ""),
        ("panther_body", ""),
        ("Hatchling", ""),
        ("Shortfin", ""),
        ("Legume", ""),
        ("male_bodysuit01", "suit"),
        ("TopHat", "hat"),
        ("crop_top", "shirt"),
        ("pants", "trouser"),
        ("Shorts_02", "trouser"),
        ("blue jeans", "trouser"),
        ("cap01", "hat"),
        ("LeftEye", "eye"),
        ("EyeLashes", "lash"),
        ("eye_brows", "brow"),
        ("Eye_Brown", "eye"),
        ("eyeglasses", "glasses"),
        ("CoatMesh", "jacket"),
        ("TopTeeth", "teeth"),
        ("short01", ""),
        ("short_hair", "hair"),
        ("dress_shoes", "shoe"),
        ("Clothes_shirt", "shirt"),
        ("glass_eye", "eye"),
        ("eye_patch", "accessory"),
        ("Ludwig", ""),
        ("BlondeWig", "hair"),
        ("Hourglass", ""),
        ("armchair", ""),
    ],
)
def test_words_of_passengers(name: str, word: str) -> None:
    assert passenger_word(name) == word


def test_parents_are_bones() -> None:
    assert set(BONE_PARENTS.values()) - {"-"} <= set(BONE_PARENTS)


def gltf(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


@pytest.mark.parametrize("name", ["mh_male_young.vrm", "saturday06_skinned_morph_vrm0.vrm"])
def test_bones_that_vrm_files_state(shared_data: Path, name: str) -> None:
    path = shared_data / "characters" / "foreign" / name
    if not path.is_file():
        pytest.skip(f"{path} is not beside this checkout")
    document = gltf(path)
    nodes = document["nodes"]
    if "VRMC_vrm" in document["extensions"]:
        stated = {
            bone: one["node"] for bone, one in document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"].items()
        }
    else:
        stated = {one["bone"]: one["node"] for one in document["extensions"]["VRM"]["humanoid"]["humanBones"]}
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    depth = {k: len(list(_above(k, parents))) for k in range(len(nodes))}
    joints = sorted(document["skins"][0]["joints"], key=depth.get)
    named = [nodes[k]["name"] for k in joints]
    rig = rig_of(named, [nodes[parents[k]]["name"] if parents.get(k) in joints else "" for k in joints])
    found = {bone: joints[joint] for bone, joint in humanoid_joints(rig).items()}
    assert {bone: found.get(bone) for bone in stated} == stated


def _above(node: int, parents: dict[int, int]):
    while (node := parents.get(node, -1)) >= 0:
        yield node
