"""Descriptors in the spectral domain: Definition 3 of the paper."""

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.paper.constraints import (
    choose_filters,
    heat_filters,
    heat_times,
    landmark_descriptors,
    normalise_columns,
    signatures,
    wave_energies,
    wave_filters,
)

from refusals import refuses

RNG = np.random.default_rng(314)


@pytest.fixture
def spectrum():
    return np.concatenate([[0.0], np.sort(RNG.uniform(1.0, 90.0, 19))])


def test_heat_times_span_the_recommended_range(spectrum):
    times = heat_times(spectrum, 16)
    assert times[0] == pytest.approx(4 * np.log(10) / spectrum[-1])
    assert times[-1] == pytest.approx(4 * np.log(10) / spectrum[1])
    np.testing.assert_allclose(np.diff(np.log(times)), np.diff(np.log(times))[0])


def test_heat_filters_scale_with_area(spectrum):
    """lambda t has no unit: a shape twice as large at four times the time has the same filters."""
    times = heat_times(spectrum, 5)
    np.testing.assert_allclose(heat_filters(spectrum / 4.0, 4.0 * times), heat_filters(spectrum, times), rtol=1e-12)


@pytest.mark.parametrize("count", [3, 8, 20, 30, 100])
def test_wave_filters_are_bands_of_energy(spectrum, count):
    energies, width = wave_energies(spectrum, count)
    filters = wave_filters(spectrum, energies, width)
    assert width == pytest.approx(np.log(spectrum[-1] / spectrum[1]) * (7.0 / count if count > 28 else 0.125))
    assert np.all(np.diff(energies) > 0.0)
    assert np.log(spectrum[1]) < energies[0]
    assert energies[-1] < np.log(spectrum[-1])
    nearest = np.argmin(abs(np.log(spectrum[1:])[:, None] - energies), axis=0)
    np.testing.assert_array_equal(np.argmax(filters[1:], axis=0), nearest)
    np.testing.assert_array_equal(filters[0], 0.0)  # the constant has no energy


def test_filters_of_a_coarser_level_are_the_leading_rows(spectrum):
    """Chosen once, so that the low block of F^{l+1} is F^l (eq. 15)."""
    filters = choose_filters(spectrum, 1.1 * spectrum, 4, 5)
    np.testing.assert_array_equal(filters.at(spectrum)[:12], filters.at(spectrum[:12]))
    for heat, wave in ((0, 0), (10**20, 0), (-1, 20)):
        refuses(ParameterError, "expected 1 to 1000 filters", choose_filters, spectrum, spectrum, heat, wave)


def test_signatures_do_not_see_signs_or_rotations_of_an_eigenspace(spectrum):
    """A repeated eigenvalue's eigenvectors are arbitrary up to rotation; descriptors of full eigenspaces are not."""
    repeated = spectrum.copy()
    repeated[4:7] = repeated[4]
    rows = RNG.standard_normal((30, 20))
    rotation, _ = np.linalg.qr(RNG.standard_normal((3, 3)))
    rotated = rows.copy()
    rotated[:, 4:7] = rows[:, 4:7] @ rotation
    rotated[:, 9] *= -1.0
    filters = heat_filters(repeated, heat_times(repeated, 6))
    np.testing.assert_allclose(signatures(rotated, filters), signatures(rows, filters), rtol=1e-12)
    landmark = rotated @ landmark_descriptors(rotated[:3], filters)
    np.testing.assert_allclose(landmark, rows @ landmark_descriptors(rows[:3], filters), atol=1e-12)


def test_normalised_columns():
    columns = RNG.standard_normal((5, 4))
    columns[:, 2] = 0.0
    np.testing.assert_allclose(np.linalg.norm(normalise_columns(columns), axis=0), [1, 1, 0, 1])


def test_too_small_a_spectrum_is_refused():
    refuses(ParameterError, "at least 2 eigenvalues above 0, got 1", heat_times, np.array([0.0, 3.0]), 4)
    refuses(ParameterError, "filters: expected 3 rows", landmark_descriptors, np.zeros((2, 3)), np.zeros((4, 5)))
