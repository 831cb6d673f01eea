"""Tests of the widths of the blur that are measured from speckle, on exact Gaussian speckle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter

from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.speckle_width import speckle_spread

SPACING = np.array([0.5e-3, 0.4e-3, 0.6e-3])
SHAPE = (70, 90, 64)
DECIBELS = 0.25


def speckle(seed, widths):
    """Power of fully developed speckle, blurred by widths in m along X, Y and Z."""
    rng = np.random.default_rng(seed)
    sigma = np.array(widths) / FWHM_PER_SIGMA / SPACING
    real, imaginary = (gaussian_filter(rng.normal(size=SHAPE), sigma) for _ in range(2))
    power = real**2 + imaginary**2
    return power / power.mean()


def volume(power, gain=40.0):
    levels = (10 * np.log10(power) + gain) / DECIBELS
    return Volume(
        intensities=np.clip(np.rint(levels), 1, 255).astype(np.uint8),
        origin=np.array([-20e-3, 5e-3, -15e-3]),
        spacing=SPACING,
        X_WP=RigidTransform(),
        time=0.0,
        decibels_per_level=DECIBELS,
    )


@settings(max_examples=5, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lateral=st.floats(1e-3, 2.5e-3),
    axial=st.floats(0.7e-3, 1.5e-3),
    elevation=st.floats(1.2e-3, 3e-3),
)
def test_the_widths_are_those_of_the_blur(seed, lateral, axial, elevation):
    spread = speckle_spread(volume(speckle(seed, (lateral, axial, elevation))))
    for name, true in {"lateral": lateral, "axial": axial, "elevation": elevation}.items():
        measured = getattr(spread, name)
        assert np.median(measured) == pytest.approx(true, rel=0.15)
        assert measured == pytest.approx(true, rel=0.35)


def test_structures_and_gain_hardly_matter():
    power = speckle(1, (1.5e-3, 0.8e-3, 2.0e-3))
    plain = speckle_spread(volume(power))
    y = np.arange(SHAPE[1])[:, np.newaxis]
    marred = power * 10 ** (-0.02 * y)
    marred[20:50, 30:33, 25:35] *= 1e4  # a bright sheet
    marred[:, 60:, :20] *= 1e-3  # a shadow
    found = speckle_spread(volume(marred, gain=45.0))
    for name in ("lateral", "axial", "elevation"):
        measured, expected = getattr(found, name), getattr(plain, name)
        assert np.median(measured) == pytest.approx(np.median(expected), rel=0.15)


def test_depths_have_their_own_widths():
    near, far = speckle(2, (1.2e-3, 0.8e-3, 1.5e-3)), speckle(3, (2.4e-3, 0.8e-3, 3.0e-3))
    near[:, 45:] = far[:, 45:]
    spread = speckle_spread(volume(near))
    assert spread.depth[0] < 5e-3 + 45 * SPACING[1] < spread.depth[-1]
    assert spread.lateral[[0, -1]] == pytest.approx([1.2e-3, 2.4e-3], rel=0.3)
    assert spread.elevation[[0, -1]] == pytest.approx([1.5e-3, 3.0e-3], rel=0.3)


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_without_speckle_there_are_no_widths(level):
    assert speckle_spread(volume(np.full(SHAPE, 1e-9 + level))) is None


@pytest.mark.parametrize("depth", [2, 12])
def test_a_shallow_volume_has_few_depths_and_no_error(depth):
    levels = np.random.default_rng(0).rayleigh(40, (60, depth, 50)).clip(1, 255).astype(np.uint8)
    shallow = Volume(
        intensities=levels, origin=np.zeros(3), spacing=np.full(3, 2e-3), X_WP=RigidTransform(),
        time=0.0,
    )  # fmt: skip
    spread = speckle_spread(shallow)
    assert spread is None or len(spread.depth) <= depth
