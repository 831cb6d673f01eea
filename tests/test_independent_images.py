"""Tests of the volumes that are made independently of the project's own renderer."""

import numpy as np
import pytest
from independent_images import Scene, volume_case
from pydrake.math import RigidTransform, RollPitchYaw

SMALL = {"shape": (56, 50, 40), "spacing": 0.65e-3}
WIDTHS = {"axial": 0, "lateral": 1, "elevation": 2}


def envelope(scene):
    """Envelope of the tissue, without its layers."""
    medium, echo = scene.still(scene.X_WT)
    return np.abs(echo) / medium.scattering


def correlation_width(values, axis):
    """Full width at half maximum of the autocovariance along an axis, in samples."""
    values = values - values.mean()
    lags = range(16)
    n = values.shape[axis]
    covariance = np.array(
        [np.mean(values.take(range(n - i), axis) * values.take(range(i, n), axis)) for i in lags]
    )
    below = int(np.argmax(covariance < 0.5 * covariance[0]))
    return 2 * np.interp(
        0.5 * covariance[0], covariance[[below, below - 1]], [below, below - 1]
    )  # fmt: skip


@pytest.mark.parametrize("moving", [False, True])
def test_the_envelope_of_speckle_has_a_rayleigh_distribution(moving):
    middle = envelope(Scene(np.random.default_rng(100), moving=moving))[10:-10, 10:-10, 5:-5]
    assert middle.mean() / middle.std() == pytest.approx(1.91, abs=0.08)
    assert np.mean(middle**2) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("seed", [100, 103])
@pytest.mark.parametrize("direction", WIDTHS)
def test_speckle_is_as_wide_as_the_point_spread(seed, direction):
    """The autocovariance of the intensity is as wide as a point's echo (both are Gaussian)."""
    scene = Scene(np.random.default_rng(seed), **SMALL)
    beams, spread = scene.beams, scene.spread
    power = envelope(scene) ** 2
    axis = WIDTHS[direction]
    for row in (np.array([0.25, 0.7]) * beams.shape[0]).astype(int):
        rows = power if direction == "axial" else power[row - 6 : row + 7]
        r = beams.axes[0][row]
        pitch = beams.pitch[0] if axis == 0 else beams.axes[axis][1] - beams.axes[axis][0]
        stated = spread.axial
        if axis:
            beam = spread.lateral if axis == 1 else spread.elevation
            stated = spread.width(beam, r) / (r + beams.radii[axis - 1])
        measured = pitch * correlation_width(rows, axis)
        assert measured == pytest.approx(stated, rel=0.25), (direction, row)


@pytest.mark.parametrize("seed", [100, 101])
def test_the_truth_lies_on_bright_voxels(seed):
    volume, truth = volume_case(
        np.random.default_rng(seed), structures=(), level=18, X_WP=random_pose(seed), **SMALL
    )
    p_P = volume.to_probe(truth.curve[truth.visible])
    assert len(p_P) > 10
    inside = volume.intensities[volume.intensities > 0].astype(float)
    aside = np.linspace(-truth.radius, truth.radius, 5)[:, np.newaxis, np.newaxis] * np.eye(3)[1]
    wall = volume.sample(p_P + aside).max(axis=0)
    assert np.median(volume.decibels_per_level * (wall - np.median(inside))) > 6
    np.testing.assert_allclose(truth.curve[0], truth.entry)
    np.testing.assert_allclose(truth.curve[-1], truth.tip)


def random_pose(seed):
    rng = np.random.default_rng(seed)
    return RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3))


def test_tissue_rests_in_the_world_while_the_probe_moves():
    scene = Scene(np.random.default_rng(109), moving=True, shape=(60, 50, 40), spacing=0.4e-3)
    moved = scene.X_WT.multiply(RigidTransform([0, 0.7e-3, 0]))
    first, second = scene.volume()[0], scene.volume(moved)[0]
    index = np.indices(first.intensities.shape)[:, 10:-10, 10:-10, 8:-8].reshape(3, -1).T
    p_W = first.to_world(first.position(index))[0]
    at_rest = np.corrcoef(first.sample(first.to_probe(p_W)), second.sample(second.to_probe(p_W)))
    along = np.corrcoef(first.sample(first.to_probe(p_W)), second.sample(first.to_probe(p_W)))
    assert at_rest[0, 1] > 0.7
    assert abs(along[0, 1]) < 0.4
