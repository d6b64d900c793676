"""Numbers of meshes and blend shapes, and lengths, in VRM's extensions, for a character on another body."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from cagemap.files.gltf.entries import Document

# Lengths in metres of VRM 1 and 0: of spring bones, colliders and the point between the eyes.
_LENGTHS = ("hitRadius", "radius", "offset", "tail", "offsetFromHeadBone", "firstPersonBoneOffset")


class ReplacedMesh(NamedTuple):
    """A node with a mesh in the input, and the node of the output with this mesh or a part of it."""

    node_before: int
    mesh_before: int
    node: int
    mesh: int | None  # None: the mesh is not written
    shapes_before: Sequence[str]
    shapes: Sequence[str]


def renumber_expressions(extensions: Any, replaced: Sequence[ReplacedMesh]) -> list[str]:
    """Renumber meshes and shapes in VRM's expressions and first-person flags; remove references to what is not written.

    Returns the names of expressions that have no shape left. Entries that VRM's schema does not know stay as they are,
    but a shape's number that is out of range is removed if the list of shapes changed. Nodes of the input keep their
    own flags.

    ``extensions``: of the document; changed in place.
    """
    empty, given = [], {one.node_before for one in replaced}
    flagged = [one for one in replaced if one.node == one.node_before or one.node not in given]
    for name, key in (("VRMC_vrm", "node"), ("VRM", "mesh")):  # VRM 1 refers to nodes, VRM 0 to meshes
        vrm = _table(extensions, name)
        person = _table(vrm, "firstPerson")
        if isinstance(person.get("meshAnnotations"), list):
            person["meshAnnotations"] = _renumbered(person["meshAnnotations"], key, flagged)
        for label, expression, binds in _expressions(vrm):
            before = expression.get(binds)
            if not before or not isinstance(before, list):
                continue
            expression[binds] = _renumbered(before, key, replaced)
            if not expression[binds]:
                empty.append(label)
                if name == "VRMC_vrm":  # its schema has no empty lists
                    del expression[binds]
    return empty


def with_scaled_lengths(document: Document, factor: float) -> Document:
    """The document with the radii and offsets of VRM's spring bones, colliders and eyes multiplied by a factor."""
    top = json.loads(json.dumps(document.json))
    extensions = _table(top, "extensions")
    of_vrm = [_table(_table(extensions, "VRMC_vrm"), "lookAt"), _table(extensions, "VRMC_springBone")]
    of_vrm += [_table(_table(extensions, "VRM"), key) for key in ("firstPerson", "secondaryAnimation")]
    for table in of_vrm:
        table |= _scaled(table, factor)
    return replace(document, json=top)


def _scaled(value: Any, factor: float, *, is_length: bool = False) -> Any:
    if isinstance(value, dict):
        return {key: _scaled(one, factor, is_length=is_length or key in _LENGTHS) for key, one in value.items()}
    if isinstance(value, list):
        return [_scaled(one, factor, is_length=is_length) for one in value]
    return factor * value if is_length and isinstance(value, float | int) else value


def _expressions(vrm: dict[str, Any]) -> list[tuple[str, dict[str, Any], str]]:
    """Names and entries of expressions, and the key of their shapes: of VRM 1, then of VRM 0."""
    kinds = (_table(_table(vrm, "expressions"), kind) for kind in ("preset", "custom"))
    found = [(name, one, "morphTargetBinds") for kind in kinds for name, one in kind.items()]
    groups = _table(vrm, "blendShapeMaster").get("blendShapeGroups")
    tables = [one for one in groups if isinstance(one, dict)] if isinstance(groups, list) else []
    found += [(str(one.get("name")), one, "binds") for one in tables]
    return [one for one in found if isinstance(one[1], dict)]


def _renumbered(entries: list[Any], key: str, replaced: Sequence[ReplacedMesh]) -> list[Any]:
    """Entries that refer to a node or mesh by ``key``, and maybe to a shape by its index, with new numbers."""
    kept: list[Any] = []
    for entry in entries:
        number = entry.get(key) if isinstance(entry, dict) else None
        users = [one for one in replaced if number == (one.node_before if key == "node" else one.mesh_before)]
        kept += [] if users else [entry]
        for one in (user for user in users if user.mesh is not None):
            made = entry | {key: one.node if key == "node" else one.mesh}
            if "index" in entry and [*one.shapes] != [*one.shapes_before]:
                names = [name for place, name in enumerate(one.shapes_before) if place == entry["index"]]
                if not set(names) & set(one.shapes):
                    continue
                made["index"] = one.shapes.index(names[0])
            kept.append(made)
    return kept


def _table(table: Any, key: str) -> dict[str, Any]:
    """The table at a key of a table; empty if there is none."""
    value = table.get(key) if isinstance(table, dict) else None
    return value if isinstance(value, dict) else {}
