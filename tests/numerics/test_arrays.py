"""Conversion of user input to arrays of numbers."""

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import whole_numbers

from refusals import refuses


def test_objects_that_are_whole_numbers_are_taken_exactly() -> None:
    for given in ([1, 2**60 + 1], [np.int32(1), 2.0], []):
        found = whole_numbers(np.array(given, dtype=object), "vertices")
        assert found.dtype == np.int64
        assert found.tolist() == given
    assert whole_numbers(np.zeros((0, 2), dtype=object), "vertices").shape == (0, 2)


@pytest.mark.parametrize("given", [["1"], [True], [None], [1.5], [2**64], [np.nan], [[1], [2]], [1j]])
def test_other_objects_are_refused(given: list[object]) -> None:
    objects = np.empty(len(given), dtype=object)
    objects[:] = given
    refuses(ParameterError, "vertices: expected whole numbers", whole_numbers, objects, "vertices")


def test_the_message_shows_the_given_values() -> None:
    refuses(ParameterError, r"got object values such as \[1 None\]", whole_numbers, [1, None], "vertices")
    refuses(ParameterError, r"got \[\[1\], \[1, 2\]\]", whole_numbers, [[1], [1, 2]], "vertices")
