"""Values hold arrays, which do not compare to one truth: every value is equal to itself alone, and can be hashed."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re

import numpy as np

import cagemap
from cagemap.deform.config import ElasticConfig
from cagemap.deform.placement import Placement
from cagemap.files.images.image import Image
from cagemap.maps.result import LevelMap
from cagemap.pipeline import MatchConfig
from cagemap.research import gather_constraints

from example_result import identity_result

ARRAYS = re.compile(r"Array|ndarray|csr_array|csc_array|TriangleSurface|SurfacePoints")


def values_with_arrays() -> list[type]:
    found = []
    for module in pkgutil.walk_packages(cagemap.__path__, "cagemap."):
        if module.name.startswith("cagemap.studio"):  # needs libraries that are not always there
            continue
        for one in vars(importlib.import_module(module.name)).values():
            if isinstance(one, type) and dataclasses.is_dataclass(one) and one.__module__ == module.name:
                # Words of help texts in annotations are no types.
                types = [re.sub(r"""(["']).*?\1""", "", str(field.type)) for field in dataclasses.fields(one)]
                if any(ARRAYS.search(kind) for kind in types):
                    found.append(one)
    return found


def test_values_of_arrays_are_equal_to_themselves_alone_and_hashable() -> None:
    values = values_with_arrays()
    assert len(values) > 50
    # A configuration that may be given arrays compares by what it holds; what starts with _ is no value.
    wrong = [
        one.__name__
        for one in values
        if one.__eq__ is not object.__eq__ and one.__name__[0] != "_" and not one.__name__.endswith("Config")
    ]
    assert wrong == []
    assert all(one.__hash__ is not None for one in values if one.__name__[0] != "_")


def test_configurations_with_arrays_compare_by_what_they_hold_and_stay_short() -> None:
    for options in ({}, {"masks": cagemap.Masks(np.ones(999))}, {"symmetries": (2 * (np.arange(9999),),)}):
        method = "paper" if "symmetries" in options else "elastic"
        config = MatchConfig(method=method, **options)
        for equal in (pickle.loads(pickle.dumps(config)), copy.deepcopy(config)):
            assert config == equal
            assert hash(config) == hash(equal)
        assert len(repr(config)) < 250
        assert config != dataclasses.replace(config, use_symmetry=False)
        assert (config == MatchConfig(method=method)) == (not options)
    assert MatchConfig(masks=cagemap.Masks(np.ones(9))) != MatchConfig(masks=cagemap.Masks(None, np.ones(9)))
    shared = MatchConfig(masks=cagemap.Masks().within(cagemap.Masks(np.ones(9), np.ones(8))))
    assert pickle.loads(pickle.dumps(shared)) == shared != MatchConfig(masks=cagemap.Masks(np.ones(9), np.ones(8)))
    assert MatchConfig() != 0


def test_configurations_show_what_was_chosen_and_signatures_stay_short() -> None:
    config = MatchConfig(answer=1, elastic=ElasticConfig(coarse_vertices=10))
    assert repr(config) == "MatchConfig(elastic=ElasticConfig(coarse_vertices=10), answer=1)"
    assert repr(MatchConfig()) == "MatchConfig()"
    assert len(str(inspect.signature(cagemap.match))) < 300


def test_values_show_themselves_in_a_line() -> None:
    """What a notebook shows of them: no arrays."""
    result = identity_result(1)
    mesh, pair = result.target.control, cagemap.pair_of(result.target, result.source, result.landmarks)
    image = Image(np.zeros((4, 8, 3), dtype=np.uint8), (), "sRGB")
    values = (mesh, result, result.landmarks, pair, cagemap.transfer_of(result), image, result.target.operators)
    values += (pair.landmarks, result.quality, result.spectral, cagemap.Masks(target=np.ones(4)))
    values += (cagemap.weld_mesh(mesh), cagemap.plain_mesh(mesh), gather_constraints(pair))
    values += (LevelMap((0, 0), np.eye(9), np.arange(9)), Placement(np.zeros((9, 3))))
    for value in values:
        assert re.fullmatch(rf"{type(value).__name__}\(.{{10,250}}\)", repr(value)), repr(value)
        assert "array" not in repr(value)
    assert repr(mesh) == f"ControlMesh({mesh.name!r}, {mesh.n_vertices} vertices, {mesh.n_faces} faces)"
    assert repr(cagemap.Masks(np.eye(4)[0])) == "Masks(target: 1 of 4 vertices)"
    assert repr(image) == "Image(4 x 8 x 3 uint8, sRGB)"
