"""A needle in a whole volume, without a prediction."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.diagrams.papers.zhao2012.method.whole_volume_ransac import (
    WholeVolumeRansacParameters,
    localize_in_whole_volume,
)
from sonoservo.systems.signals import Volume
from sonoservo.systems.tracking import RansacParameters, TipParameters

SPACING = 0.4e-3
X_WP = RigidTransform(RotationMatrix.MakeXRotation(-1.2), [0.1, 0.0, 0.2])
START, TIP = np.array([6e-3, 9e-3, 10e-3]), np.array([22e-3, 14e-3, 12e-3])
PARAMETERS = WholeVolumeRansacParameters(
    candidate_volume=60e-9,
    ransac=RansacParameters(residual_threshold=1e-3, min_separation=1e-3, refits=1),
    tip=TipParameters(tube_radius=0.5e-3, smoothing=0.75e-3, beam_width=1e-3),
)


def needle_volume(seed, level=200.0, dtype=np.uint8, gap=None):
    """A blurred line in exponential speckle; a gap is a stretch of abscissae that is dark."""
    rng = np.random.default_rng(seed)
    grid = SPACING * np.stack(np.meshgrid(*[np.arange(70)] * 3, indexing="ij"), -1)
    length = np.linalg.norm(TIP - START)
    a = (grid - START) @ (TIP - START) / length
    aside = np.linalg.norm(grid - START - a[..., None] * (TIP - START) / length, axis=-1)
    inside = (a > 0) & (a < length)
    if gap is not None:
        inside &= (a < gap[0]) | (a > gap[1])
    grey = rng.normal(80, 12, a.shape) + level * inside * np.exp(-((aside / 0.5e-3) ** 2))
    return Volume(np.clip(grey, 1, 255).astype(dtype), np.zeros(3), [SPACING] * 3, X_WP, 0.7)


TOWARDS = X_WP.rotation().matrix() @ np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize(("dtype", "sense"), [(np.uint8, 1), (np.float32, -1)])
def test_finds_both_ends_in_the_world(dtype, sense):
    found = localize_in_whole_volume(
        needle_volume(0, dtype=dtype), sense * TOWARDS, PARAMETERS, np.random.default_rng(0)
    )
    ends = found.fit.axis.position([found.start, found.tip])[::sense]
    np.testing.assert_allclose(X_WP.inverse() @ ends.T, np.array([START, TIP]).T, atol=0.7e-3)
    k = sense * found.fit.axis.direction
    true = X_WP.rotation().matrix() @ (TIP - START) / np.linalg.norm(TIP - START)
    assert np.degrees(np.arccos(min(k @ true, 1))) < 1.5
    measured = found.measurement(0.7, 1e-3, 16.0)
    np.testing.assert_allclose(measured.curve.control_points, ends[::sense], atol=1e-12)
    assert np.linalg.eigvalsh(measured.covariance)[0] >= 0.99e-6


@pytest.mark.parametrize(("gap", "reaches"), [((10e-3, 11.2e-3), True), ((10e-3, 14e-3), False)])
def test_short_gaps_do_not_end_the_needle(gap, reaches):
    found = localize_in_whole_volume(
        needle_volume(0, gap=gap), TOWARDS, PARAMETERS, np.random.default_rng(0)
    )
    tip = X_WP.inverse() @ found.fit.axis.position(found.tip)
    length = (tip - START) @ (TIP - START) / np.linalg.norm(TIP - START)
    assert length == pytest.approx(np.linalg.norm(TIP - START) if reaches else 10e-3, abs=0.8e-3)


@pytest.mark.parametrize("level", [0, 7])
def test_a_constant_volume_holds_no_needle(level):
    volume = Volume(np.full((30, 30, 30), level, np.uint8), np.zeros(3), [SPACING] * 3, X_WP, 0.0)
    found = localize_in_whole_volume(volume, TOWARDS, PARAMETERS, np.random.default_rng(0))
    assert not found
    assert "constant" in found.reason


def test_a_single_bright_spot_is_no_needle():
    grey = np.zeros((30, 30, 30), np.uint8)
    grey[15, 15, 15:17] = 255
    volume = Volume(grey, np.zeros(3), [SPACING] * 3, X_WP, 0.0)
    spot = dataclasses.replace(PARAMETERS, candidate_volume=2 * SPACING**3)
    found = localize_in_whole_volume(volume, TOWARDS, spot, np.random.default_rng(0))
    assert not found
    assert "too few" in found.reason
