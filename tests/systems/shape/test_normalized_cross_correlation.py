"""Normalized cross-correlation against its definition, scikit-image and known displacements."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from skimage.feature import match_template

from sonoservo.systems.shape.normalized_cross_correlation import (
    Match,
    _peak_offset,
    best_match,
    normalized_cross_correlation,
)


def definition(search, kernel):
    """Eq. 8 of Zhao 2012, with the mean of each window, by NumPy's correlation coefficient."""
    windows = np.lib.stride_tricks.sliding_window_view(search, kernel.shape).reshape(
        -1, kernel.size
    )
    windows = windows - windows.mean(axis=1, keepdims=True)
    pattern = kernel.ravel() - kernel.mean()
    return windows @ pattern / np.sqrt(np.sum(windows**2, axis=1) * np.sum(pattern**2))


@given(
    shape=st.lists(st.integers(3, 9), min_size=1, max_size=3),
    shares=st.lists(st.floats(0.3, 1), min_size=3, max_size=3),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=15, deadline=None)
def test_is_the_correlation_coefficient_of_every_window(shape, shares, seed):
    rng = np.random.default_rng(seed)
    search = rng.normal(size=shape)
    small = [max(2, round(m * share)) for m, share in zip(shape, shares, strict=False)]
    kernel = rng.normal(size=small)
    rho = normalized_cross_correlation(search, kernel)
    assert rho.shape == tuple(M - m + 1 for M, m in zip(shape, small, strict=True))
    np.testing.assert_allclose(rho.ravel(), definition(search, kernel), atol=1e-9)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 1e-5)])
def test_agrees_with_scikit_image_in_the_published_window(dtype, tolerance):
    rng = np.random.default_rng(0)
    search = (50 + rng.normal(size=(11, 37, 61))).astype(dtype)
    kernel = search[2:9, 8:29, 5:56] + rng.normal(size=(7, 21, 51)).astype(dtype)
    rho = normalized_cross_correlation(search, kernel)
    assert rho.dtype == dtype
    # In single precision it is scikit-image that is off, by 1e-3.
    theirs = match_template(search.astype(float), kernel.astype(float))
    np.testing.assert_allclose(rho, theirs, atol=tolerance)


def texture(shape, displacement, samples_per_period, seed):
    """Band-limited noise on a carrier along the last axis, displaced exactly: a sum of waves."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(200, 3)) * [0.45, 0.4, 0.45]
    waves[:, 2] += 2 * np.pi / samples_per_period
    amplitudes = np.exp(1j * (rng.uniform(0, 2 * np.pi, 200) - waves @ displacement))
    factors = [np.exp(1j * np.outer(np.arange(m), w)) for m, w in zip(shape, waves.T, strict=True)]
    return np.einsum("im,jm,km,m->ijk", *factors, amplitudes, optimize=True).real


@pytest.mark.parametrize("samples_per_period", [3.6, 8.0])
def test_finds_a_displacement_to_a_fraction_of_a_sample(samples_per_period):
    rng = np.random.default_rng(0)
    errors, rounded = [], []
    for seed in range(40):
        displacement = rng.uniform(-1.4, 1.4, 3)
        kernel = texture((15, 21, 41), np.full(3, -3), samples_per_period, seed)
        match = best_match(texture((21, 27, 47), displacement, samples_per_period, seed), kernel)
        assert isinstance(match, Match)
        assert not match.at_border.any()
        errors.append(match.position - 3 - displacement)
        rounded.append(np.round(match.position) - 3 - displacement)
    error, coarse = np.std(errors, axis=0), np.std(rounded, axis=0)
    assert (np.abs(np.mean(errors, axis=0)) < 0.03).all()
    assert (error < 0.1).all()
    assert (coarse > 0.2).all()


def test_at_a_border_the_other_axes_are_found_to_a_fraction():
    """Waves run askew, so the correlation peaks elsewhere along the line beside the border's."""
    rng = np.random.default_rng(3)
    waves = rng.normal(size=(200, 2)) @ [[0.45, 0.45], [0.0, 0.4]]
    phases = rng.uniform(0, 2 * np.pi, 200)
    image = np.zeros((20, 40))
    for (a, b), phase in zip(waves, phases, strict=True):
        image += np.cos(a * np.arange(20)[:, np.newaxis] + b * np.arange(40) + phase)
    for offset in (-0.4, 0.3):
        moved = np.fft.ifft(np.fft.fft(image) * np.exp(-2j * np.pi * np.fft.fftfreq(40) * offset))
        match = best_match(image[:, 4:36], moved.real[5:, 10:30])
        assert match.at_border.tolist() == [True, False]
        assert match.position[0] == 5
        assert match.position[1] == pytest.approx(6 - offset, abs=0.12)


def test_the_border_is_told():
    search = np.random.default_rng(0).normal(size=(9, 9))
    match = best_match(search, search[0:5, 2:7])
    assert match.at_border.tolist() == [True, False]
    assert match.position[0] == 0
    assert match.correlation == pytest.approx(1)
    # Along an axis that leaves no choice there is no border to be at.
    assert best_match(search[:5], search[:5, 2:7]).at_border.tolist() == [False, False]


@pytest.mark.parametrize(("level", "dtype"), [(0.1, np.float32), (1e6, np.float64)])
def test_constant_windows_correlate_with_nothing(level, dtype):
    rng = np.random.default_rng(0)
    search = np.full((8, 9, 10), level, dtype)
    kernel = rng.normal(size=(3, 4, 5)).astype(dtype)
    assert not normalized_cross_correlation(search, kernel).any()
    assert not normalized_cross_correlation(kernel, search[:2, :2, :2]).any()
    search[4:, :, :] += rng.normal(size=(4, 9, 10)).astype(dtype)
    rho = normalized_cross_correlation(search, kernel)
    assert not rho[:2].any()
    assert rho[4:].all()


@pytest.mark.parametrize(
    ("search", "kernel", "reason"),
    [
        (np.eye(4), np.eye(5), "does not fit"),
        (np.full((4, 4), np.nan), np.eye(2), "not finite"),
        (np.eye(4), np.array([[1, np.inf], [0, 1]]), "not finite"),
        (np.eye(4), np.ones((2, 2)), "kernel is constant"),
        (np.ones((4, 4)), np.eye(2), "resembles"),
        (np.zeros((4, 4)), np.eye(2), "resembles"),
    ],
)
def test_says_why_there_is_no_match(search, kernel, reason):
    found = best_match(search, kernel)
    assert not found
    assert reason in found.reason


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_a_constant_patch_has_its_peak_in_the_middle(level):
    assert _peak_offset(np.full((3, 3), level)).tolist() == [0, 0]


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="kernel.shape"):
        normalized_cross_correlation(np.eye(3), np.eye(4))
    with pytest.raises(ValueError, match="kernel has shape"):
        normalized_cross_correlation(np.eye(3), np.ones(2))
