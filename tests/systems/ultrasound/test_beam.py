import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line

from sonoservo.diagrams.papers.zhao2012.phantom import IMAGING as ZHAO
from sonoservo.systems.ultrasound.beam import axial_width, elevation_width, lateral_width
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer

PROBE = Transducer()
FOCUS_60 = ImagingParameters(focus_depth=0.060)
TRUS = ImagingParameters(depth=0.06, transmit_frequency=6.5e6, focus_depth=0.03)
LINEAR = ImagingParameters(depth=0.04, transmit_frequency=7.0e6, focus_depth=0.016)
"""A middle frequency, focused where the probe's lens is."""


def pymust_half_width(depth, axis, probe, imaging):
    """Full width at half amplitude (m) of the echo of a point that moves sideways."""
    expected = (
        lateral_width(depth, probe, imaging)
        if axis == 0
        else elevation_width(depth, probe, imaging)[0]
    )
    offsets = expected * np.array([0, 0.4, 0.5, 0.6])
    peaks = []
    for offset in offsets:
        point = [offset, depth, 0] if axis == 0 else [0, depth, offset]
        peaks.append(middle_line(probe, imaging, [point], [1.0], depth).max())
    return 2 * np.interp(0.5, (np.array(peaks) / peaks[0])[::-1], offsets[::-1])


@pytest.mark.parametrize(
    ("probe", "imaging", "depth"),
    [
        (PROBE, FOCUS_60, 0.06),
        (load_transducer("zhao2012"), ZHAO, 0.05),
        (load_transducer("trus"), TRUS, 0.03),
        (load_transducer("4dl14_5_38"), LINEAR, 0.016),
    ],
    ids=["4dc7_3_40", "zhao2012", "trus", "4dl14_5_38"],
)
def test_widths_match_pymust_at_the_focus(probe, imaging, depth):
    lateral, elevation = (pymust_half_width(depth, axis, probe, imaging) for axis in (0, 1))
    assert lateral_width(depth, probe, imaging) == pytest.approx(lateral, rel=0.1)
    assert elevation_width(depth, probe, imaging)[0] == pytest.approx(elevation, rel=0.1)


@pytest.mark.parametrize(
    ("depth", "lateral", "elevation"),
    [(40, 2.34, 1.74), (60, 1.48, 2.23), (80, 2.36, 3.06), (100, 3.93, 4.08)],
)
def test_widths_match_pymust_as_recorded(depth, lateral, elevation):
    """Millimetres, from PyMUST with this probe, by `pymust_half_width`."""
    assert lateral_width(1e-3 * depth, PROBE, FOCUS_60) == pytest.approx(1e-3 * lateral, rel=0.1)
    width, _ = elevation_width(1e-3 * depth, PROBE, FOCUS_60)
    assert width == pytest.approx(1e-3 * elevation, rel=0.1)


@pytest.mark.parametrize("height", [0.008, 0.016])
def test_elevation_at_the_lens_focus_is_the_diffraction_limit(height):
    """A focused slit used both ways: sinc^2, whose width at half is 0.886 wavelength z / H.

    That holds for one frequency; the short pulse's lower ones widen it a little.
    """
    transducer = dataclasses.replace(PROBE, element_height=height)
    width, curvature = elevation_width(PROBE.lens_focus, transducer, FOCUS_60)
    limit = 0.886 * FOCUS_60.wavelength * PROBE.lens_focus / height
    assert width == pytest.approx(limit, rel=0.08)
    # In the focal plane the wave front is a sphere about the aperture's centre.
    assert curvature == pytest.approx(1 / PROBE.lens_focus, rel=0.05)


def test_wave_fronts_converge_before_the_lens_focus():
    _, curvature = elevation_width(0.02, PROBE, FOCUS_60)
    assert curvature == pytest.approx(-1 / (PROBE.lens_focus - 0.02), rel=0.1)


def test_axial_width_shrinks_with_bandwidth():
    """Near 0.44 c / B for a pulse that the transducer, not the excitation, limits."""
    narrow, wide = (axial_width(3.3e6, bandwidth, 1540) for bandwidth in (0.2, 0.7))
    assert narrow == pytest.approx(0.44 * 1540 / (0.2 * 3.3e6), rel=0.1)
    assert wide == pytest.approx(0.40e-3, rel=0.05)
