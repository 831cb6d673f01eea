import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from renderers import make_renderer

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.tissue import Tissue

DOWN = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0, 0, -0.004])
NEEDLES = [Needle(np.array([[-0.05, 0, -0.03], [0.0, 0, -0.03]]), 0.635e-3)] * 5


@pytest.fixture(scope="module")
def renderer():
    few = {"sector": 0.1, "depth": 0.05, "frames": 5, "volume_rate": 8}
    return make_renderer(Tissue(), **few, focus_depth=0.025, dynamic_range_db=48.0)


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
