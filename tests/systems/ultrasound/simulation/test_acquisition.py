import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from renderers import CLEAN

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

DOWN = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0, 0, -0.004])
NEEDLES = [Needle(np.array([[-0.05, 0, -0.03], [0.0, 0, -0.03]]), 0.635e-3)] * 5


@pytest.fixture(scope="module")
def renderer():
    return SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(
            sector=0.1, depth=0.05, frames=5, volume_rate=8, dynamic_range_db=48.0
        ),
        tissue=Tissue(),
        parameters=CLEAN,
        seed=7,
    )


@pytest.mark.parametrize("direction", [1, -1])
def test_frames_are_made_one_after_the_other_whichever_way(renderer, direction):
    geometry = renderer.geometry
    times = geometry.frame_times(2.0, direction)
    made = times[::direction]
    assert made[0] == 2.0
    np.testing.assert_allclose(np.diff(made), geometry.frame_period)
    middle = geometry.frame_times(2.0, direction, since=2)
    assert middle[2] == 2.0


def test_a_sweep_at_rest_is_what_the_renderer_shows(renderer):
    geometry = renderer.geometry
    motion = SweepMotion.at_rest(geometry, DOWN, geometry.frame_times(1.0, -1), -1)
    sweep = acquire_sweep(renderer, motion, NEEDLES, number=3)
    poses = np.repeat(DOWN.GetAsMatrix4()[np.newaxis], 5, axis=0)
    np.testing.assert_array_equal(sweep.samples, renderer.render(poses, NEEDLES, -1, 3))
    np.testing.assert_array_equal(sweep.motion.X_WP, poses)
    assert sweep.motion.direction == -1
    assert sweep.decibels_per_level == 48 / 255
    conversion = ScanConversion(geometry, make_grid(geometry, 2e-3))
    assert conversion(sweep).point_spread is sweep.point_spread is renderer.point_spread
    other = acquire_sweep(renderer, motion, NEEDLES, number=4)
    assert (other.samples != sweep.samples).any()  # other noise


def test_only_the_pose_in_the_tissue_matters_to_what_is_seen(renderer):
    """Probe and tissue moved together show the same, at another place in the world."""
    away = RigidTransform([0.4, 0.1, 0.2])
    times = renderer.geometry.frame_times(0.0)
    here = SweepMotion.at_rest(renderer.geometry, DOWN, times)
    there = SweepMotion.at_rest(renderer.geometry, away @ DOWN, times)
    first = acquire_sweep(renderer, here, NEEDLES)
    second = acquire_sweep(renderer, there, NEEDLES, X_TP=here.X_WP)
    np.testing.assert_array_equal(first.samples, second.samples)
    np.testing.assert_allclose(second.motion.X_WP[:, :3, 3] - first.motion.X_WP[:, :3, 3], [
        [0.4, 0.1, 0.2]
    ] * 5)  # fmt: skip
