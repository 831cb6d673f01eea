"""The needle's echo: angle law, thickness, floor, reverberation, shadow, tip."""

import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line
from renderers import DEEP, NOWHERE, make_renderer, needle_through, still

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.tissue import Fibre
from sonoservo.systems.ultrasound.transducer import Transducer


def needle_echo(renderer, needle):
    """The needle's share of the echoes, for a needle without a shadow."""
    poses = still(renderer)
    frames = renderer.geometry.frames
    return renderer.echo(poses, [needle] * frames, 1) - renderer.echo(poses, [NOWHERE] * frames, 1)


def specular_level(renderer, azimuth, rise):
    """Peak level in dB of the middle lines of the middle frame, 60 mm deep; lines 0.05 mm fine."""
    echo = needle_echo(renderer, needle_through([0, 0, -0.16], azimuth, rise))
    geometry = renderer.geometry
    lines = np.abs(echo[geometry.frames // 2, geometry.lines // 2 - 1 : geometry.lines // 2 + 1])
    i = round(0.06 / geometry.sample_pitch)
    return 20 * np.log10(lines[:, i - 40 : i + 40].max(axis=1)).mean()


BARE = {"shadow": 0.0, "reverberation_db": -200.0}
ROUGH = {"diffuse_lobe_deg": None, "diffuse_db": -20.0}


def test_needle_mirrors_sound_as_a_smooth_rod_does():
    """Angle law sigma_s / sigma_l exp(-(2k sin a)^2 sigma_s^2 / 2), near 0 dB at normal incidence.

    1 / sigma_s^2 = cos^2 a / sigma_l^2 + sin^2 a / sigma_a^2: the part of the rod in the cell.
    """
    needle = NeedleEchoParameters(**BARE, diffuse_db=-200.0)
    renderer = make_renderer(needle=needle, sector=0.2, sample_pitch=0.05e-3)
    beam = renderer.beam
    lateral = beam.lateral[round(0.06 / renderer.geometry.sample_pitch)]
    k = 4 * np.pi / beam.wavelength
    normal = specular_level(renderer, 0.0, 0.0)
    assert normal == pytest.approx(needle.specular_db, abs=0.5)
    for degrees in (3, 6):
        a = np.deg2rad(degrees)
        s = 1 / np.sqrt(np.cos(a) ** 2 / lateral**2 + np.sin(a) ** 2 / beam.axial**2)
        law = s / lateral * np.exp(-((k * np.sin(a) * s) ** 2) / 2)
        level = np.mean([specular_level(renderer, 0.0, rise) for rise in (a, -a)])
        assert level - normal == pytest.approx(20 * np.log10(law), abs=1.0)
    # Turned about the vertical it stays normal to the beam.
    assert specular_level(renderer, np.deg2rad(90), 0.0) - normal == pytest.approx(0, abs=1.5)


def test_needles_angle_law_matches_pymust():
    """Echo of a smooth rod 60 mm deep over its tilt, against PyMUST's of points along it."""
    needle = NeedleEchoParameters(**BARE, diffuse_db=-200.0)
    renderer = make_renderer(needle=needle, sector=0.2, sample_pitch=0.05e-3)
    imaging = ImagingParameters(focus_depth=0.06)
    s = np.arange(-8e-3, 8e-3, imaging.wavelength / 4)
    # Faded ends echo nothing of their own.
    ends = np.sin(np.pi / 2 * np.clip((8e-3 - np.abs(s)) / 2e-3, 0, 1)) ** 2
    levels = []
    for a in np.deg2rad([0, 4, 7]):
        ours = np.mean([specular_level(renderer, 0.0, rise) for rise in (a, -a)])
        points = np.stack([s * np.cos(a), 0.06 + s * np.sin(a), np.zeros(len(s))], axis=1)
        theirs = middle_line(Transducer(), imaging, points, ends, 0.06).max()
        levels.append([ours, 20 * np.log10(theirs)])
    ours, theirs = np.transpose(np.array(levels[1:]) - levels[0])
    assert (theirs > -24).all()
    assert ours == pytest.approx(theirs, abs=3)


def test_needle_has_a_diffuse_floor():
    needle = NeedleEchoParameters(**BARE | ROUGH)
    renderer = make_renderer(needle=needle, sector=0.2, sample_pitch=0.1e-3)
    powers = [
        10 ** (specular_level(renderer, azimuth, np.deg2rad(rise)) / 10)
        for azimuth in (0.0, 0.3)
        for rise in (12, 15, -12, -15)
    ]
    floor = 10 * np.log10(np.mean(powers)) - needle.specular_db
    assert floor == pytest.approx(needle.diffuse_db, abs=4)


def test_reverberations_follow_the_needle_at_its_inner_diameter():
    needle = NeedleEchoParameters(**BARE | {"reverberation_db": -8.0}, diffuse_db=-200.0)
    renderer = make_renderer(needle=needle, sector=0.2, sample_pitch=0.05e-3)
    echo = np.abs(needle_echo(renderer, needle_through([0, 0, -0.16], 0.0, 0.0)))
    line = echo[13, renderer.geometry.lines // 2]
    peaks = np.flatnonzero((line[1:-1] > line[:-2]) & (line[1:-1] > line[2:])) + 1
    peaks = peaks[line[peaks] > line.max() * 10 ** (-30 / 20)][:4]
    # The front wall is one radius above the axis; sound is slower in the water inside.
    first = 0.06 - 0.635e-3
    assert peaks[0] * renderer.geometry.sample_pitch == pytest.approx(first, abs=0.1e-3)
    inner = 2 * 0.635e-3 * needle.inner_diameter_ratio
    assert np.diff(peaks) * renderer.geometry.sample_pitch == pytest.approx(
        inner * 1540 / 1480, abs=0.06e-3
    )
    assert 20 * np.diff(np.log10(line[peaks])) == pytest.approx(-8, abs=1)


def test_needle_casts_a_shadow():
    renderer = make_renderer(needle=NeedleEchoParameters(shadow=0.4), sector=0.2)
    frames, lines = renderer.geometry.frames, renderer.geometry.lines
    needle = needle_through([0, 0, -0.14], 0.0, 0.0)
    without = np.abs(renderer.echo(still(renderer), [NOWHERE] * frames, 1))
    shadowed = np.abs(renderer.echo(still(renderer), [needle] * frames, 1))
    behind = round(0.06 / renderer.geometry.sample_pitch)
    ratio = shadowed[..., behind:] / without[..., behind:]
    assert np.median(ratio[13, lines // 2]) == pytest.approx(0.6, abs=0.02)
    assert np.median(ratio[0]) == pytest.approx(1, abs=1e-3)  # far to the side
    before = round(0.03 / renderer.geometry.sample_pitch)
    assert np.allclose(shadowed[..., :before], without[..., :before])


def test_a_needle_ends_at_its_tip():
    """The rough part, of random phases, runs out at the tip, here below the middle of the probe."""
    renderer = make_renderer(
        needle=NeedleEchoParameters(**BARE | ROUGH, specular_db=40.0), sector=0.4
    )
    tip = np.array([0.0, 0, -0.16])
    echo = np.abs(needle_echo(renderer, Needle(np.array([tip - [0.05, 0, 0], tip]), 0.635e-3)))
    level = echo[13].max(axis=1)
    middle, line = renderer.geometry.lines // 2, renderer.geometry.line_pitch * 0.1
    beyond = middle + int(np.ceil(4e-3 / line))
    assert level[beyond:].max() < 0.1 * np.median(level[: middle - int(4e-3 / line)])


def tip_level(parameters, dip_deg, roll_deg=0.0):
    """Peak level in dB around a tip 60 mm deep below the middle of the probe, smooth shaft."""
    echo = NeedleEchoParameters(**BARE | parameters, diffuse_db=-200.0)
    renderer = make_renderer(needle=echo, sector=0.4, sample_pitch=0.05e-3)
    dip, tip = np.deg2rad(dip_deg), np.array([0.0, 0, -0.16])
    along = np.array([np.cos(dip), 0, -np.sin(dip)])
    needle = Needle(np.array([tip - 0.05 * along, tip]), 0.635e-3, roll=np.deg2rad(roll_deg))
    echo = np.abs(needle_echo(renderer, needle)[13])
    middle, i = renderer.geometry.lines // 2, round(0.06 / renderer.geometry.sample_pitch)
    return 20 * np.log10(echo[middle - 6 : middle + 7, i - 120 : i + 120].max()), renderer


def test_a_cut_cylinder_ends_as_a_line_of_points_does():
    """A blunt end echoes 1 / (2k sin a) of the line's amplitude per metre: its one open end."""
    for dip in (25, 40):
        level, renderer = tip_level({"tip": "blunt"}, dip)
        lateral = renderer.beam.lateral[round(0.06 / renderer.geometry.sample_pitch)]
        k = 2 * np.pi / renderer.beam.wavelength
        a = np.deg2rad(dip)
        end = np.sqrt(np.cos(a)) / (2 * k * np.sin(a) * np.sqrt(2 * np.pi) * lateral)
        assert level == pytest.approx(40 + 20 * np.log10(end), abs=2.5)


def test_a_bevel_is_a_mirror_of_its_own():
    """Its face shines where it is square to the beam, as a flat ellipse does.

    A plane's amplitude is its area; a cylinder's, over the length l, l sqrt(pi r / k) (Kirchhoff).
    A needle that rises by the bevel's angle holds its face square to the beam.
    """
    level, renderer = tip_level({"bevel_deg": 30.0}, -30.0)
    lateral = renderer.beam.lateral[round(0.06 / renderer.geometry.sample_pitch)]
    radius, k = 0.635e-3, 2 * np.pi / renderer.beam.wavelength
    face = np.pi * radius**2 / np.sin(np.deg2rad(30))
    line = np.sqrt(2 * np.pi) * lateral * np.sqrt(np.pi * radius / k)
    # The beam weakens the ends of a face that is not small against it.
    u = np.linspace(-1, 1, 201)
    beam = np.exp(-((u * radius / np.sin(np.deg2rad(30)) / lateral) ** 2) / 2)
    seen = np.average(beam, weights=np.sqrt(1 - u**2))
    assert level == pytest.approx(40 + 20 * np.log10(seen * face / line), abs=2)
    assert level - tip_level({"bevel_deg": 30.0}, -30.0, 90.0)[0] > 10


def test_a_tip_shows_best_with_its_bevel_towards_the_probe_or_away_from_it():
    """As Hopkins and Bradley (2001) saw; their beam met the needle at 20 and 60 deg."""
    levels = {roll: tip_level({}, 20.0, roll)[0] for roll in (0, 60, 120, 180)}
    assert max(levels[0], levels[180]) > max(levels[60], levels[120])
    assert levels[180] == max(levels.values())


def test_a_fibre_is_as_bright_as_a_needle():
    fibre = Fibre(start=[-0.01, 0, -0.16], end=[0.01, 0, -0.16], level_db=38.0)
    renderer = make_renderer(dataclasses.replace(DEEP, fibres=[fibre]), sector=0.2)
    echo = np.abs(renderer.tissue_echo(still(renderer), 1))
    assert 20 * np.log10(echo.max()) == pytest.approx(38, abs=3)
