import numpy as np
import pytest
from pymust_referee import middle_line

from sonoservo.systems.ultrasound.beam import beam_profile, elevation_width, lateral_width
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

PROBE = load_transducer("4dl14_5_38")
IMAGING = ImagingParameters(
    transmit_frequency=7.5e6,
    focus_depth=0.03,
    depth=0.045,
    sector=1.0,
    sample_pitch=0.1e-3,
    frames=1,
    frame_pitch_deg=0.01,
    volume_rate=20.0,
)


def pymust_width(depth, axis, expected):
    """Full width at half amplitude (m) of the echo of a point that moves sideways."""
    offsets = expected * np.array([0, 0.4, 0.5, 0.6])
    peaks = []
    for offset in offsets:
        point = [offset, depth, 0] if axis == 0 else [0, depth, offset]
        peaks.append(middle_line(PROBE, IMAGING, [point], [1.0], depth).max())
    return 2 * np.interp(0.5, (np.array(peaks) / peaks[0])[::-1], offsets[::-1])


@pytest.mark.parametrize(
    "depth", [0.03, *(pytest.param(d, marks=pytest.mark.slow) for d in (0.02, 0.025, 0.035, 0.04))]
)
def test_widths_match_pymust(depth):
    lateral = lateral_width(depth, PROBE, IMAGING)
    elevation, _ = elevation_width(depth, PROBE, IMAGING)
    assert lateral == pytest.approx(pymust_width(depth, 0, lateral), rel=0.1)
    assert elevation == pytest.approx(pymust_width(depth, 1, elevation), rel=0.1)


def test_lines_are_parallel_and_cover_the_face():
    geometry = sweep_geometry(PROBE, IMAGING)
    ends = geometry.position(0, np.array([0, geometry.lines - 1])[:, np.newaxis], [0, 450], 1)
    width = ends[1, :, 0] - ends[0, :, 0]
    assert width[0] == pytest.approx(38.6e-3, rel=0.02)
    assert width[1] == pytest.approx(width[0], rel=0.011)
    assert np.abs(ends[..., 1] - [0, 0.045]).max() < 0.06e-3


def test_its_beam_is_smooth():
    geometry = sweep_geometry(PROBE, IMAGING)
    beam = beam_profile(PROBE, IMAGING, geometry)
    for width in (beam.lateral, beam.elevation):
        assert width.shape == (geometry.samples,)
        assert np.isfinite(width).all()
        deep = width[geometry.samples // 4 :]
        assert np.abs(np.diff(deep)).max() < 0.05 * width.max()
