import numpy as np
from synthetic_volumes import Scene

from sonoservo.systems.signals.volume import acquired_from

RNG = np.random.default_rng(0)


def test_acquired_from_inverts_a_moving_probe():
    volume = Scene(seed=3, spacing=1.0e-3).volume(0)
    motion = volume.motion
    poses = motion.X_WP.copy()
    poses[:, 0, 3] += np.linspace(-3e-3, 3e-3, len(poses))
    moving = type(motion)(motion.geometry, motion.direction, motion.times, poses)
    volume = type(volume)(
        volume.intensities, volume.origin, volume.spacing, volume.X_WP, volume.time, moving
    )
    p_W = RNG.uniform([-0.02, 0.02, -0.01], [0.02, 0.06, 0.01], (50, 3))
    np.testing.assert_allclose(volume.to_world(acquired_from(volume, p_W))[0], p_W, atol=2e-5)
