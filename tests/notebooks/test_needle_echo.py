import runpy
from pathlib import Path

import numpy as np
import pytest

from sonoservo.systems.signals.sweep import Sweep, SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.transducer import Transducer

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
measure_needle_echo = runpy.run_path(str(NOTEBOOKS / "needle_echo.py"))["measure_needle_echo"]

IMAGING = ImagingParameters(gain=0.3)
GEOMETRY = sweep_geometry(Transducer(), IMAGING)


def sweep_over(shaft, radius, db):
    """A sweep over even tissue and a tube that is brighter by so many dB."""
    k, j, i = np.meshgrid(*(np.arange(n) for n in GEOMETRY.shape), indexing="ij")
    p_P = GEOMETRY.position(k, j, i, 1)
    a, b = shaft
    share = np.clip((p_P - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    distance = np.linalg.norm(p_P - a - share[..., np.newaxis] * (b - a), axis=-1)
    levels = IMAGING.tissue_grey + IMAGING.grey_per_db * np.where(distance < radius, db, 0)
    times = GEOMETRY.frame_period * np.arange(GEOMETRY.frames)
    poses = np.tile(np.eye(4), (GEOMETRY.frames, 1, 1))
    return Sweep(np.round(levels).astype(np.uint8), SweepMotion(GEOMETRY, 1, times, poses))


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
def test_level_length_and_thickness_of_a_tube(tilt_deg):
    tilt = np.deg2rad(tilt_deg)
    along = np.array([np.cos(tilt), np.sin(tilt), 0])
    shaft = np.array([0, 0.045, 0]) + np.outer([-0.012, 0.018], along)
    echo = measure_needle_echo(sweep_over(shaft, 2e-3, 25), shaft, IMAGING)
    assert echo.peak_db == pytest.approx(25, abs=0.2)
    assert echo.visible_length == pytest.approx(0.030, abs=0.5e-3)
    # At -20 dB of 25, the edges between samples are counted in.
    assert echo.thickness == pytest.approx(4e-3, abs=0.7e-3)


def test_what_is_faint_or_outside_the_sector_is_not_visible():
    shaft = np.array([[-0.09, 0.045, 0], [0.0, 0.045, 0]])
    echo = measure_needle_echo(sweep_over(shaft, 2e-3, 25), shaft, IMAGING)
    # 45 mm deep, 85 mm from the centre of the array:
    edge = 0.085 * np.tan(np.deg2rad(0.608768 * 47.5))
    assert echo.visible_length == pytest.approx(edge, abs=1e-3)
    assert np.isnan(echo.level_db[0])
    assert np.isfinite(echo.level_db[-1])
    faint = measure_needle_echo(sweep_over(shaft, 2e-3, 9), shaft, IMAGING)
    assert faint.visible_length == 0
