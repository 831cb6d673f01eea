"""Shift of the tissue between two volumes, made by resampling one that is known everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter, map_coordinates

from sonoservo.systems.signals import Volume
from sonoservo.systems.tracking.cells import Cells, cells_of, tissue_shift

EDGES = np.array([1.5e-3, 1.4e-3, 1.6e-3])
SHAPE = (40, 34, 26)
WORLD = 6 * gaussian_filter(np.random.default_rng(0).normal(size=(80, 80, 80)), 2.0)
WORLD /= WORLD.std() / 4
STARTS = [np.zeros(3), np.array([0.0, 0.0, 3e-3]), np.array([0.0, 0.0, -3e-3])]


def cells(X_TP=None, noise=0.0, seed=0):
    """Cells of what a probe at a pose in the tissue sees."""
    X_TP = X_TP or RigidTransform()
    origin = -EDGES * (np.array(SHAPE) - 1) / 2
    p = np.indices(SHAPE).reshape(3, -1).T * EDGES + origin
    p_T = X_TP.multiply(p.T).T / 1.5e-3 + 40
    levels = map_coordinates(WORLD, p_T.T, order=3).reshape(SHAPE)
    levels += noise * np.random.default_rng(seed).normal(size=SHAPE)
    lit = np.ones(SHAPE, bool)
    return Cells(levels.astype(np.float32), lit, lit, np.zeros(SHAPE[1], "f4"), origin, EDGES)


@pytest.mark.parametrize("breath", [[0.4e-3, -0.7e-3, 0.2e-3], [0, 1e-3, 4.5e-3]])
def test_the_shift_of_the_tissue_is_found(breath):
    """A breath may be several cells large, and the probe has moved."""
    X_BN = RigidTransform(RollPitchYaw(0.02, 0.06, -0.03), [4e-3, -1e-3, 3e-3])
    before, now = cells(noise=0.5), cells(RigidTransform(breath) @ X_BN, noise=0.5, seed=1)
    shift, _ = tissue_shift(now, before, X_BN.GetAsMatrix4(), STARTS)
    np.testing.assert_allclose(shift, breath, atol=0.15e-3)


def test_what_comes_in_between_does_not_move_the_tissue():
    before, now = cells(), cells(RigidTransform([0.5e-3, 0, 0.5e-3]))
    levels = now.levels.copy()
    levels[5:30, 15:18, 12:15] = 14.0
    shift, _ = tissue_shift(replace(now, levels=levels), before, np.eye(4), STARTS)
    np.testing.assert_allclose(shift, [0.5e-3, 0, 0.5e-3], atol=0.1e-3)


def test_what_rides_with_the_probe_does_not_move_the_tissue():
    """Two fifths of the image ride along; the probe moves by two cells."""
    X_BN = RigidTransform([3e-3, 0, 0])
    before, now = cells(), cells(X_BN)
    riding = np.arange(SHAPE[2]) < 0.4 * SHAPE[2]
    pattern = cells(RigidTransform([0, 0, 0.04])).levels
    before, now = (
        replace(each, levels=np.where(riding, pattern, each.levels)) for each in (before, now)
    )
    shift, _ = tissue_shift(now, before, X_BN.GetAsMatrix4(), STARTS)
    np.testing.assert_allclose(shift, 0, atol=0.4e-3)


@pytest.mark.parametrize("away", [0.02, 0.03, 0.04])
def test_unlike_images_tell_nothing_about_a_shift(away):
    """Their best shift is one by chance; that of alike ones is known to a fraction of a cell."""
    before, known = cells(noise=4.0), []
    for place in (away, 0.0):
        now = cells(RigidTransform([0, 0, place]), noise=4.0, seed=1)
        shift, information = tissue_shift(now, before, np.eye(4), STARTS)
        known.append(np.linalg.eigvalsh(information))
    assert (known[0] < 1 / 3e-3**2).all()
    assert (known[1] > 1 / 0.4e-3**2).all()
    # Half of what these show is speckle of their own, which is smaller between the cells.
    np.testing.assert_allclose(shift, 0, atol=0.3e-3)


def test_cells_are_the_means_of_what_was_seen_above_their_surroundings():
    seen = np.ones((64, 60, 62), bool)
    seen[:, :20] = False
    levels = np.where(seen, 80.0, 0.0)
    levels[32:34, 39:42, 30:32] += 40.0
    levels[:20, 20:, :30] -= 60.0  # a shadow
    spacing = np.array([0.75e-3, 0.5e-3, 0.75e-3])
    image = Volume(
        levels.astype(np.float32), np.array([-0.03, 0, -0.03]), spacing, RigidTransform(), 0.0,
        decibels_per_level=0.25, mask=seen,
    )  # fmt: skip
    found = cells_of(image)
    np.testing.assert_allclose(found.edges, 1.5e-3)
    np.testing.assert_allclose(found.origin, image.origin + (found.edges - image.spacing) / 2)
    i, j, k = np.unravel_index(found.levels.argmax(), found.levels.shape)
    np.testing.assert_allclose(
        found.origin + found.edges * [i, j, k], image.position([32.5, 40, 30.5]), atol=0.8e-3
    )
    assert found.levels.max() == pytest.approx(10.0, abs=0.6)
    assert not found.seen[:, :6].any()
    assert found.seen[:, 8:].all()
    assert np.all(found.levels[~found.seen] == 0)
    np.testing.assert_allclose(found.darkest_at(np.array([0.02])), 13.0, atol=0.1)
    assert not found.lit[:7, 14:, :12].any()
    assert found.lit[14:, 8:].all()
    far = found.seen & found.lit
    far[:16, :, :22] = False  # around the shadow
    far[i - 9 : i + 10, j - 9 : j + 10, k - 9 : k + 10] = False
    np.testing.assert_allclose(found.levels[far], 0, atol=0.3)
