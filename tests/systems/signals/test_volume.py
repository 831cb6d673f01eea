from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from synthetic_volumes import Scene

from sonoservo.systems.signals import Volume
from sonoservo.systems.signals.volume import acquired_from


def make(**changes):
    arguments = {
        "intensities": np.zeros((4, 5, 6), np.uint8),
        "origin": [-0.01, 0, -0.02],
        "spacing": [1e-3, 2e-3, 3e-3],
        "X_WP": RigidTransform([1, 2, 3]),
        "time": 0.5,
    }
    return Volume(**(arguments | changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"intensities": np.full((4, 5, 6), np.nan, np.float32)},
        {"intensities": np.zeros((0, 5, 6), np.uint8)},
        {"intensities": np.full((4, 5, 6), 255.5, np.float32)},
        {"intensities": np.full((4, 5, 6), -1, np.int16)},
        {"spacing": [0.7, 0.7, 0.7]},
    ],
)
def test_bad_volumes_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        make(**changes)


def test_what_was_seen_is_the_mask_or_the_sector_or_the_hull():
    volume = Scene().volume(1)
    inside = volume.intensities > 0  # this scene has no black speckle
    spots = np.indices(inside.shape).sum(axis=0) % 7 == 3
    dark = replace(volume, intensities=np.where(spots, 0, volume.intensities))
    np.testing.assert_array_equal(dark.seen, inside)  # from the transducer
    np.testing.assert_array_equal(replace(dark, motion=None, mask=inside).seen, inside)
    hull = replace(dark, motion=None).seen
    assert np.mean(hull[inside]) > 0.97
    assert np.mean(hull[~inside]) < 0.01
    with pytest.raises(ValueError, match="mask"):
        make(mask=np.ones((4, 5, 7), bool))


def test_a_position_is_seen_beside_an_element_that_was():
    mask = np.zeros((4, 5, 6), bool)
    mask[1, 2, 3] = True
    volume = make(mask=mask)
    at = volume.position(np.array([[1, 2, 3], [1.9, 1.1, 3.9], [2, 2, 3], [1, 0.9, 3], [-1, 2, 3]]))
    np.testing.assert_array_equal(volume.sees(at), [True, True, False, False, False])


def test_black_is_below_what_was_cut_off():
    """Where dark levels were removed; outside, nothing was seen."""
    volume = Scene().volume(1)
    cut = np.where(volume.intensities < 100, 0, volume.intensities)
    known = replace(volume, intensities=cut)
    assert known.without_cut() is known
    foreign = replace(volume, intensities=cut, motion=None)
    raised = foreign.without_cut()
    np.testing.assert_array_equal(raised.seen, foreign.seen)
    least = cut[cut > 0].min()
    wanted = np.where(foreign.seen, np.maximum(cut, least), 0)
    np.testing.assert_array_equal(raised.intensities, wanted)
    plain = replace(volume, motion=None)
    assert plain.without_cut() is plain
    assert make().without_cut().intensities.max() == 0


@pytest.mark.parametrize("level", ["speckle", "sparse"])
def test_dark_cysts_shadows_and_water_are_seen(level):
    volume = Scene().volume(1)
    p_P = volume.position(np.moveaxis(np.indices(volume.intensities.shape), 0, -1))
    inside = volume.intensities > 0
    x, y, z = np.moveaxis(p_P, -1, 0)
    cyst = np.linalg.norm(p_P - [0, 0.05, 0], axis=-1) < 8e-3
    shadow = (np.abs(x - 0.01) < 4e-3) & (np.abs(z) < 4e-3) & (y > 0.03)
    grey = np.where(cyst | shadow, 0, volume.intensities)
    if level == "sparse":
        grey[grey < np.quantile(grey[grey > 0], 0.97)] = 0
    hull = replace(volume, intensities=grey, motion=None).seen
    assert hull[(cyst | shadow) & inside].all()
    assert np.mean(hull & ~inside) < (0.01 if level == "speckle" else 0.1)
    assert make().seen.all()  # darkness alone tells nothing
    (line := np.zeros((4, 5, 6), np.uint8))[1, 1:4, 2] = 9
    assert make(intensities=line).seen.sum() == 3


def test_acquired_from_inverts_a_moving_probe():
    volume = Scene(seed=3, spacing=1.0e-3).volume(0)
    poses = volume.motion.X_WP.copy()
    poses[:, 0, 3] += np.linspace(-3e-3, 3e-3, len(poses))
    volume = replace(volume, motion=replace(volume.motion, X_WP=poses))
    p_W = np.random.default_rng(0).uniform([-0.02, 0.02, -0.01], [0.02, 0.06, 0.01], (50, 3))
    np.testing.assert_allclose(volume.to_world(acquired_from(volume, p_W))[0], p_W, atol=2e-5)
