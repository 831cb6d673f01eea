import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume

X_WP = RigidTransform(RollPitchYaw(-1.5, 0.2, 0.7), [0.4, 0.1, 0.3])
GEOMETRY = SweepGeometry(
    array_radius=0.04,
    motor_radius=0.02725,
    line_pitch=np.deg2rad(0.6),
    frame_pitch=np.deg2rad(1.5),
    sample_pitch=0.3e-3,
    lines=96,
    frames=27,
    samples=290,
    frame_period=0.0112,
)


@pytest.fixture
def geometry() -> SweepGeometry:
    return GEOMETRY


@pytest.fixture
def make_volume():
    """Make a volume whose intensities are a function of the position in P."""

    def make(function, *, time=0.5, dtype=np.uint8, motion=True, shape=(60, 45, 40)) -> Volume:
        origin, spacing = np.array([-0.06, 0.0, -0.04]), np.array([2e-3, 2e-3, 2e-3])
        grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
        times = np.linspace(time - 0.15, time + 0.15, GEOMETRY.frames)
        poses = np.tile(X_WP.GetAsMatrix4(), (GEOMETRY.frames, 1, 1))
        return Volume(
            function(origin + spacing * grid).astype(dtype),
            origin,
            spacing,
            X_WP,
            time,
            SweepMotion(GEOMETRY, 1, times, poses) if motion else None,
        )

    return make
