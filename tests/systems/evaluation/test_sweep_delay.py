import numpy as np
import pytest
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter, map_coordinates

from sonoservo.systems.evaluation.source_checks import Grade, check_delay, sweep_delay
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame

SIZE, PITCH, LATTICE = (40, 50), 0.8e-3, 1e-3
TISSUE = gaussian_filter(np.random.default_rng(100).normal(size=(50, 60, 60)), 1.5)


def sweeps(delay, count=4, frames=40, period=0.05):
    """Frames of a probe that slides to and fro over still tissue, with poses that are late."""

    def along(time):
        phase = time / (frames * period)
        return 0.024 * (0.5 - 0.5 * np.cos(np.pi * phase))

    X_FI = np.diag([PITCH, PITCH, 1e-3, 1.0])
    i, j = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]), indexing="ij")
    made = []
    for sweep in range(count):
        made.append([])
        for k in range(frames):
            time = (sweep * frames + k) * period
            where = np.stack([PITCH * i, PITCH * j, np.full(SIZE, along(time))])
            place = (where + np.array([4e-3, 4e-3, 15e-3])[:, None, None]) / LATTICE
            grey = 120 + 400 * map_coordinates(TISSUE, place, order=1)
            X_WF = RigidTransform([0, 0, along(time - delay)])
            pixels = np.clip(grey, 1, 255).astype(np.float32)
            made[-1].append(PosedFrame(pixels, X_WF.GetAsMatrix4() @ X_FI, time))
    return made


@pytest.mark.parametrize("delay", [0.0, -0.12])
def test_delay_of_poses_is_found_within_its_interval(delay):
    found, std = sweep_delay(sweeps(delay))
    assert found == pytest.approx(delay, abs=0.015)
    assert abs(found - delay) < max(4 * std, 0.01)
    (finding,) = check_delay((found, std))
    assert (finding.grade is Grade.DOUBTFUL) == (abs(delay) > 0.015)


def test_a_single_pass_tells_no_delay():
    found = sweep_delay(sweeps(0.0, count=1))
    assert isinstance(found, NotFound)
    assert check_delay(found)[0].grade is Grade.FINE
