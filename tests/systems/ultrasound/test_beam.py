import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line

from sonoservo.diagrams.papers.zhao2012.phantom import IMAGING as ZHAO
from sonoservo.systems.ultrasound.beam import (
    axial_width,
    beam_profile,
    elevation_width,
    lateral_width,
)
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer

PROBE = Transducer()
FOCUS_60 = ImagingParameters(focus_depth=0.060)


TRUS = (
    load_transducer("trus"),
    ImagingParameters(depth=0.06, transmit_frequency=6.5e6, focus_depth=0.03),
)
"""Transrectal probe at a middle frequency, focused where its lens is."""
LINEAR = (
    load_transducer("4dl14_5_38"),
    ImagingParameters(depth=0.04, transmit_frequency=7.0e6, focus_depth=0.016),
)
"""Linear probe, focused where its lens is."""


def pymust_half_width(depth, axis, probe=PROBE, imaging=FOCUS_60):
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


def test_widths_match_pymust_at_the_focus():
    assert lateral_width(0.06, PROBE, FOCUS_60) == pytest.approx(
        pymust_half_width(0.06, 0), rel=0.1
    )
    assert elevation_width(0.06, PROBE, FOCUS_60)[0] == pytest.approx(
        pymust_half_width(0.06, 1), rel=0.1
    )


@pytest.mark.parametrize(
    ("probe", "imaging", "depth", "tolerance"),
    [
        (load_transducer("zhao2012"), ZHAO, 0.05, 0.1),
        (*TRUS, 0.03, 0.1),
        (*LINEAR, 0.016, 0.1),
        pytest.param(*LINEAR, 0.025, 0.1, marks=pytest.mark.slow),
        pytest.param(load_transducer("zhao2012"), ZHAO, 0.04, 0.1, marks=pytest.mark.slow),
        pytest.param(load_transducer("zhao2012"), ZHAO, 0.06, 0.1, marks=pytest.mark.slow),
        pytest.param(*TRUS, 0.02, 0.1, marks=pytest.mark.slow),
        # Half a focal length beyond the focus, the strongly curved array's beam is 13 % wider.
        pytest.param(*TRUS, 0.045, 0.15, marks=pytest.mark.slow),
    ],
)
def test_beams_of_other_probes_match_pymust(probe, imaging, depth, tolerance):
    lateral, elevation = (pymust_half_width(depth, axis, probe, imaging) for axis in (0, 1))
    assert lateral_width(depth, probe, imaging) == pytest.approx(lateral, rel=tolerance)
    assert elevation_width(depth, probe, imaging)[0] == pytest.approx(elevation, rel=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [0.04, 0.05, 0.07, 0.08, 0.09, 0.10])
def test_widths_match_pymust_from_40_to_100_mm(depth):
    assert lateral_width(depth, PROBE, FOCUS_60) == pytest.approx(
        pymust_half_width(depth, 0), rel=0.1
    )
    assert elevation_width(depth, PROBE, FOCUS_60)[0] == pytest.approx(
        pymust_half_width(depth, 1), rel=0.1
    )


@pytest.mark.parametrize(
    ("depth", "lateral", "elevation"),
    [(40, 2.34, 1.74), (60, 1.48, 2.23), (80, 2.36, 3.06), (100, 3.93, 4.08)],
)
def test_widths_match_pymust_as_recorded(depth, lateral, elevation):
    """Millimetres, from PyMUST with this probe: what the slow test computes anew."""
    assert lateral_width(1e-3 * depth, PROBE, FOCUS_60) == pytest.approx(1e-3 * lateral, rel=0.1)
    width, _ = elevation_width(1e-3 * depth, PROBE, FOCUS_60)
    assert width == pytest.approx(1e-3 * elevation, rel=0.1)


@pytest.mark.parametrize("height", [0.008, 0.012, 0.016])
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


def test_transmit_focus_sharpens_the_beam_at_its_depth():
    for focus in (0.03, 0.06):
        widths = [
            lateral_width(depth, PROBE, dataclasses.replace(FOCUS_60, focus_depth=focus))
            for depth in (0.03, 0.06)
        ]
        assert np.argmin(widths) == [0.03, 0.06].index(focus)


@pytest.mark.parametrize(
    ("name", "imaging"),
    [
        ("4dc7_3_40", ImagingParameters()),
        ("zhao2012", dataclasses.replace(ZHAO, depth=0.074, sample_pitch=0.1e-3)),
        ("trus", ImagingParameters(depth=0.06, transmit_frequency=6.5e6, focus_depth=0.03)),
    ],
)
def test_every_transducer_has_a_smooth_beam(name, imaging):
    transducer = load_transducer(name)
    geometry = sweep_geometry(transducer, imaging)
    beam = beam_profile(transducer, imaging, geometry)
    for width in (beam.lateral, beam.elevation):
        assert width.shape == (geometry.samples,)
        assert 0.2 * imaging.wavelength < width.min()
        assert width.max() < 8e-3
        deep = width[geometry.samples // 4 :]
        assert np.abs(np.diff(deep)).max() < 0.05 * width.max()
    assert np.isfinite(beam.curvature).all()


def test_equal_settings_share_a_beam_and_different_ones_do_not():
    def made(depth):
        transducer, imaging = load_transducer("4dc7_3_40"), ImagingParameters(focus_depth=depth)
        return beam_profile(transducer, imaging, sweep_geometry(transducer, imaging))

    first = made(0.025)
    assert made(0.025) is first
    assert not np.array_equal(made(0.05).lateral, first.lateral)
