"""Physics of the rendered sweep, against closed forms."""

import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.ultrasound.beam import FWHM_PER_SIGMA, transmitted_spectrum
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation import rendering
from sonoservo.systems.ultrasound.simulation.kernels.image_formation import compress, coupling
from sonoservo.systems.ultrasound.simulation.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.rendering import ScannerParameters, SweepRenderer
from sonoservo.systems.ultrasound.simulation.scatterer_tile import BLOCKS, ScattererTile
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Fibre, Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

NOWHERE = Needle(np.zeros((0, 3)), 0.635e-3)
DEEP = Tissue(size=[0.6, 0.6, 0.4])
"""Large enough to hold the whole sweep wherever the probe is."""


def make_renderer(tissue=DEEP, needle=None, transducer=None, **imaging):
    settings = {"depth": 0.09, "focus_depth": 0.06, "volume_rate": 2.0, "frames": 27}
    return SweepRenderer(
        transducer=transducer or Transducer(),
        imaging=ImagingParameters(**settings | imaging),
        tissue=tissue,
        parameters=ScannerParameters(needle=needle or NeedleEchoParameters()),
        seed=0,
    )


@pytest.fixture(scope="module")
def deep():
    return make_renderer(depth=0.13)


@pytest.fixture(scope="module")
def small():
    """A narrow sector, for many sweeps."""
    return make_renderer(sector=0.2, depth=0.07)


def about(axis, angle, point):
    """Pose (4, 4) of a rotation about an axis through a point."""
    X = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    X[i, i] = X[j, j] = np.cos(angle)
    X[i, j], X[j, i] = -np.sin(angle), np.sin(angle)
    X[:3, 3] = np.array(point) - X[:3, :3] @ point
    return X


def shift(*xyz):
    X = np.eye(4)
    X[:3, 3] = xyz
    return X


# The probe looks down: X_P along X_T, depth Y_P along -Z_T; its face 100 mm below the top.
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.1], [0, 0, 0, 1.0]])


def still(renderer, X=DOWN):
    return np.repeat(X[np.newaxis], renderer.geometry.frames, axis=0)


def upright(renderer, motion, places):
    """Poses for which every frame's plane is upright, at places of its own, moved in that plane."""
    geometry = renderer.geometry
    axis = [0, -geometry.motor_radius, 0]
    poses = []
    for theta, place in zip(geometry.line_angles(1).mean(axis=1), places, strict=True):
        poses.append(DOWN @ shift(*place) @ motion @ about(0, -theta, axis))
    return np.array(poses)


def correlation(a, b):
    return abs(np.vdot(a, b)) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real)


# --- speckle -----------------------------------------------------------------------------------


def snr(amplitude):
    return amplitude.mean() / amplitude.std()


def speckle(renderer, sweeps):
    rng = np.random.default_rng(3)
    frames = renderer.geometry.frames
    return np.concatenate(
        [
            renderer.tissue_echo(
                upright(renderer, np.eye(4), rng.uniform(-0.04, 0.04, (frames, 3))), 1
            )
            for _ in range(sweeps)
        ]
    )


def check_speckle_snr(renderer, sweeps):
    """Four scatterers in a resolution cell: 1.79, from 20 to 120 mm; mean intensity 1."""
    amplitude = np.abs(speckle(renderer, sweeps))
    depth = renderer.geometry.sample_pitch * np.arange(renderer.geometry.samples)
    for centre in np.arange(0.02, 0.121, 0.02):
        slab = amplitude[:, :, np.abs(depth - centre) < 4e-3].astype(float)
        assert snr(slab) == pytest.approx(1.79, abs=0.05)
        assert (slab**2).mean() == pytest.approx(1, rel=0.05)


def test_speckle_snr_is_that_of_four_scatterers_a_cell(deep):
    check_speckle_snr(deep, 2)


@pytest.mark.slow
def test_speckle_snr_is_that_of_four_scatterers_a_cell_over_many_sweeps(deep):
    check_speckle_snr(deep, 12)


def test_dense_tissue_has_rayleigh_speckle():
    renderer = make_renderer(
        dataclasses.replace(DEEP, scatterers_per_cell=40), sector=0.2, depth=0.07
    )
    amplitude = np.abs(speckle(renderer, 1)[:, :, 60:])
    assert snr(amplitude) == pytest.approx(1.91, abs=0.03)


@pytest.mark.parametrize("number", [2.0, 5.0])
def test_intensity_moments_are_those_of_a_k_distribution(number):
    """<I^2> / <I>^2 = 2 + 1/N = 2 (1 + 1/nu) with nu = 2 N; Zhao 2012 has nu = 10."""
    tissue = dataclasses.replace(DEEP, scatterers_per_cell=number)
    intensity = np.abs(speckle(make_renderer(tissue, sector=0.2, depth=0.07), 4)) ** 2
    intensity = intensity[:, :, 60:].astype(float)
    moment = (intensity**2).mean() / intensity.mean() ** 2
    assert moment == pytest.approx(2 + 1 / number, rel=0.04)


def autocovariance(intensity, axis):
    """At lag 1, relative to lag 0."""
    deviation = np.moveaxis(intensity - intensity.mean(), axis, 0)
    return (deviation[1:] * deviation[:-1]).mean() / (deviation**2).mean()


def widths_across_frames(renderer, transducer, depth):
    """Widths (m) of the intensity's autocovariance across frames, of the beam and of the aperture.

    Wave fronts that are not centred on the motor's axis narrow the speckle, though not the point
    spread function. The first width is the Gaussian beam's, the second that of the lens's exact
    field, turned about the motor's axis. With N scatterers in a cell, 1 / (N + 1) of the covariance
    knows no phase.
    """
    geometry, beam = renderer.geometry, renderer.beam
    e, d = np.meshgrid(
        np.arange(-9e-3, 9e-3, 0.2e-3), depth + np.arange(-1.6e-3, 1.2e-3, 0.04e-3), indexing="ij"
    )
    radius = geometry.motor_radius
    angle = geometry.frame_pitch
    e_next = e * np.cos(angle) + (d + radius) * np.sin(angle)
    d_next = (d + radius) * np.cos(angle) - e * np.sin(angle) - radius
    i = round(depth / geometry.sample_pitch)
    z = ((np.arange(32) + 0.5) / 32 - 0.5) * transducer.element_height
    delay = np.hypot(z, transducer.lens_focus) - transducer.lens_focus

    def of_beam(e, d):
        path = d - depth + beam.curvature[i] * e**2 / 2
        width = e**2 / (2 * beam.elevation[i] ** 2) + path**2 / (2 * beam.axial**2)
        return np.exp(-width - 4j * np.pi / beam.wavelength * path)

    def of_aperture(e, d):
        way = np.hypot(e[..., np.newaxis] - z, d[..., np.newaxis]) - delay
        total = np.zeros(e.shape, complex)
        for relative in np.linspace(0.3, 1.7, 9):
            k = 2 * np.pi * relative / beam.wavelength
            spectrum = transmitted_spectrum(relative, 1.0, transducer.fractional_bandwidth)
            waves = np.exp(1j * k * way).sum(axis=-1)
            total += spectrum * waves**2 * np.exp(-2j * k * depth)
        return total

    number = DEEP.scatterers_per_cell
    widths = []
    for field in (of_beam, of_aperture):
        here, there = field(e, d), field(e_next, d_next)
        coherent = correlation(here, there) ** 2
        incoherent = correlation(np.abs(here) ** 2, np.abs(there) ** 2)
        together = (coherent + incoherent / number) / (1 + 1 / number)
        widths.append(FWHM_PER_SIGMA * angle * (radius + depth) / np.sqrt(-2 * np.log(together)))
    return widths


def check_speckle_size(renderer, sweeps, tolerance):
    """The intensity's autocovariance is as wide as the point spread function, on all axes.

    Across frames that is the point spread function with its wave fronts and the motor's arc.
    """
    geometry, beam = renderer.geometry, renderer.beam
    rng = np.random.default_rng(3)
    sets = [
        renderer.tissue_echo(still(renderer, DOWN @ shift(*rng.uniform(-0.04, 0.04, 3))), 1)
        for _ in range(sweeps)
    ]
    for depth in (0.06, 0.08, 0.10):
        i = round(depth / geometry.sample_pitch)
        intensity = np.abs(np.array(sets)[..., i - 6 : i + 7].astype(complex)) ** 2
        spacing = geometry.line_pitch * (geometry.array_radius + depth)
        width = FWHM_PER_SIGMA * spacing / np.sqrt(-2 * np.log(autocovariance(intensity, 2)))
        assert width == pytest.approx(FWHM_PER_SIGMA * beam.lateral[i], rel=tolerance)
        width = geometry.sample_pitch / np.sqrt(-2 * np.log(autocovariance(intensity, 3)))
        assert width == pytest.approx(beam.axial, rel=tolerance)
        spacing = geometry.frame_pitch * (geometry.motor_radius + depth)
        width = FWHM_PER_SIGMA * spacing / np.sqrt(-2 * np.log(autocovariance(intensity, 1)))
        of_beam, of_aperture = widths_across_frames(renderer, Transducer(), depth)
        assert width == pytest.approx(of_beam, rel=tolerance)
        # A Gaussian as wide at -6 dB as the aperture's field is smoother than that field.
        assert of_aperture < width < 1.2 * of_aperture


def test_speckle_is_as_large_as_the_point_spread_function():
    check_speckle_size(make_renderer(depth=0.11, frame_pitch_deg=0.73), 3, 0.1)


@pytest.mark.slow
def test_speckle_is_as_large_as_the_point_spread_function_over_many_sweeps():
    check_speckle_size(make_renderer(depth=0.11, frame_pitch_deg=0.73), 20, 0.08)


# --- motion ------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [1, -1])
def test_probe_turned_by_one_frame_pitch_sees_frames_shifted_by_one(small, direction):
    geometry = small.geometry
    step = geometry.line_angles(1)[1, 0] - geometry.line_angles(1)[0, 0]
    turned = DOWN @ about(0, step, [0, -geometry.motor_radius, 0])
    before = small.tissue_echo(still(small), direction)
    after = small.tissue_echo(still(small, turned), direction)
    assert correlation(before[1:], after[:-1]) > 0.9999
    assert correlation(before[:-1], after[1:]) < 0.2


def test_sweeps_both_ways_differ_only_by_the_lines_own_angles(deep):
    """The middle lines hardly; the outer ones by up to a frame pitch."""
    there, back = (deep.tissue_echo(still(deep), direction) for direction in (1, -1))
    middle = deep.geometry.lines // 2
    assert correlation(there[:, middle], back[:, middle]) > 0.99
    assert correlation(there[:, 0], back[:, 0]) < 0.7


def decorrelations(renderer, motion, sweeps):
    geometry = renderer.geometry
    i = round(0.06 / geometry.sample_pitch)
    rng = np.random.default_rng(5)
    pairs = []
    for _ in range(sweeps):
        places = rng.uniform(-0.04, 0.04, (geometry.frames, 3))
        pairs.append(
            [
                renderer.tissue_echo(upright(renderer, X, places), 1)[:, :, i - 2 : i + 3]
                for X in (np.eye(4), motion)
            ]
        )
    before, after = np.moveaxis(np.array(pairs), 1, 0)
    middle = geometry.lines // 2
    return np.mean([correlation(before[:, :, j], after[:, :, j]) for j in (middle - 1, middle)])


def check_decorrelation(renderer, sweeps, tolerance):
    """Under motion of the probe the field decorrelates like the beam's own autocorrelation."""
    i = round(0.06 / renderer.geometry.sample_pitch)
    beam = renderer.beam
    lateral, elevation, bend = beam.lateral[i], beam.elevation[i], beam.curvature[i]
    k = 4 * np.pi / beam.wavelength
    d = 1e-3
    cases = [
        (shift(d, 0, 0), np.exp(-(d**2) / (4 * lateral**2))),
        (
            shift(0, 0, d),
            np.exp(-(d**2) / (4 * elevation**2) - (k * bend * d * elevation) ** 2 / 4),
        ),
    ]
    for degrees in (2, 4, 6):
        angle = np.deg2rad(degrees)
        theory = np.exp(-((k * np.sin(angle) * lateral) ** 2) / 4)
        cases.append((about(2, angle, [0, 0.06, 0]), theory))
    for motion, theory in cases:
        assert decorrelations(renderer, motion, sweeps) == pytest.approx(theory, abs=tolerance)


def test_decorrelation_follows_theory(small):
    check_decorrelation(small, 8, 0.09)


@pytest.mark.slow
def test_decorrelation_follows_theory_over_many_sweeps(small):
    check_decorrelation(small, 80, 0.04)


# --- points ------------------------------------------------------------------------------------


def peak_index(amplitude):
    """Frame, line and sample of a Gaussian's peak: logarithms of three neighbours per axis."""
    at = np.unravel_index(amplitude.argmax(), amplitude.shape)
    peak = []
    for axis, i in enumerate(at):
        near = [slice(n, n + 1) for n in at]
        near[axis] = slice(i - 1, i + 2)
        below, here, above = np.log(amplitude[tuple(near)].ravel())
        peak.append(i + (above - below) / (2 * (2 * here - below - above)))
    return peak


@pytest.mark.parametrize("direction", [1, -1])
def test_a_point_appears_where_the_geometry_says(direction):
    rng = np.random.default_rng(2)
    for _ in range(3):
        p_P = rng.uniform([-0.02, 0.04, -0.01], [0.02, 0.07, 0.01])
        p_T = (DOWN @ [*p_P, 1])[:3]
        # Eight scatterers within a micrometre, far above the tissue.
        ball = Ball(centre=list(p_T), radius=1e-6, level_db=150)
        renderer = make_renderer(dataclasses.replace(DEEP, balls=[ball]))
        peak = peak_index(np.abs(renderer.tissue_echo(still(renderer), direction)))
        assert peak == pytest.approx(renderer.geometry.index(p_P, direction), abs=0.1)


def exact_echo(renderer, p_P, direction):
    """Point spread function of a point, written out line by line without approximations."""
    geometry, beam = renderer.geometry, renderer.beam
    x, y, z = p_P[0], p_P[1] + geometry.motor_radius, p_P[2]
    theta = geometry.line_angles(direction)[:, :, np.newaxis]
    rho = y * np.cos(theta) + z * np.sin(theta)
    elevation = z * np.cos(theta) - y * np.sin(theta)
    q = rho + geometry.array_radius - geometry.motor_radius
    depth = np.hypot(q, x) - geometry.array_radius
    axis = geometry.line_pitch * (np.arange(geometry.lines) - (geometry.lines - 1) / 2)
    lateral = (np.arctan2(x, q) - axis[np.newaxis, :, np.newaxis]) * np.hypot(q, x)
    depths = geometry.sample_pitch * np.arange(geometry.samples)
    sigma_l = np.interp(depth, depths, beam.lateral)
    sigma_e = np.interp(depth, depths, beam.elevation)
    path = depth + np.interp(depth, depths, beam.curvature) * elevation**2 / 2
    weight = np.exp(-(lateral**2) / (2 * sigma_l**2) - elevation**2 / (2 * sigma_e**2))
    pulse = np.exp(-((depths - path) ** 2) / (2 * beam.axial**2))
    return weight * pulse * np.exp(-4j * np.pi * path / beam.wavelength)


@pytest.mark.parametrize("direction", [1, -1])
def test_scatterers_echo_as_the_point_spread_function_says(monkeypatch, direction):
    """One scatterer in a tile of 32 mm, in a slice of tissue that holds a column of its copies."""
    place = np.array([1.1e-3, 2.3e-3, 0.7e-3], np.float32)
    starts = np.append(0, np.ones(BLOCKS**3, int))
    tile = ScattererTile(4e-3, place[:, np.newaxis], np.zeros(1, np.float32), starts)
    monkeypatch.setattr(rendering, "scatterer_tile", lambda density, rng: tile)
    renderer = make_renderer(Tissue(size=[0.030, 0.030, 0.12]))
    X_TP = still(renderer, about(2, 0.3, [0, 0, 0]) @ shift(0.006, 0.004, 0.08) @ DOWN)
    echo = renderer.tissue_echo(X_TP, direction)
    exact = np.zeros(echo.shape, complex)
    for copy in range(1, 4):
        p_T = place - [0, 0, 0.032 * copy]
        exact += exact_echo(renderer, (np.linalg.inv(X_TP[0]) @ [*p_T, 1])[:3], direction)
    assert correlation(exact, echo) > 0.99


@pytest.mark.parametrize("level", [0.0, 0.0316])
def test_bright_points_have_side_lobes(level):
    """A second Gaussian, three times as wide, in quadrature with the beam's.

    Through it a rod's points, three times as many, echo with the wanted level.
    """
    ball = Ball(centre=[0, 0, -0.16], radius=1e-6, level_db=190)
    renderer = make_renderer(
        dataclasses.replace(DEEP, balls=[ball]),
        transducer=Transducer(side_lobe_level=level),
        sector=0.2,
    )
    echo = np.abs(renderer.tissue_echo(still(renderer), 1))
    geometry = renderer.geometry
    k, i = geometry.frames // 2, round(0.06 / geometry.sample_pitch)
    lines = np.arange(geometry.lines) - (geometry.lines - 1) / 2
    u = (lines * geometry.line_pitch * 0.1 / renderer.beam.lateral[i]) ** 2 / 2
    shape = np.hypot(np.exp(-u), level / 3 * np.exp(-u / 9))
    near = np.abs(lines) < 3
    assert echo[k, near, i] / echo[k, near, i].max() == pytest.approx(
        shape[near] / shape.max(), rel=0.03, abs=1e-3
    )
    side = echo[k, np.abs(lines) == 3.5, i].mean() / echo[k, near, i].max()
    expected = shape[np.abs(lines) == 3.5].mean() / shape.max()
    assert side == pytest.approx(expected, rel=0.1, abs=1e-5)
    assert (side > 0.0012) == (level > 0)


def needle_through(point, azimuth, rise, half_length=0.04):
    """A needle through a point of T, with its middle there; angles in rad."""
    direction = np.array(
        [np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)]
    )
    return Needle(np.array(point) + np.outer([-half_length, half_length], direction), 0.635e-3)


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


BARE = {"tip_db": -200.0, "shadow": 0.0, "reverberation_db": -200.0}


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
    for degrees in (2, 4, 6):
        a = np.deg2rad(degrees)
        s = 1 / np.sqrt(np.cos(a) ** 2 / lateral**2 + np.sin(a) ** 2 / beam.axial**2)
        law = s / lateral * np.exp(-((k * np.sin(a) * s) ** 2) / 2)
        level = np.mean([specular_level(renderer, 0.0, rise) for rise in (a, -a)])
        assert level - normal == pytest.approx(20 * np.log10(law), abs=1.0)
    # Turned about the vertical it stays normal to the beam.
    assert specular_level(renderer, np.deg2rad(90), 0.0) - normal == pytest.approx(0, abs=1.5)


def check_angle_law(degrees):
    """Echo of a smooth rod 60 mm deep over its tilt, against PyMUST's of points along it."""
    needle = NeedleEchoParameters(**BARE, diffuse_db=-200.0)
    renderer = make_renderer(needle=needle, sector=0.2, sample_pitch=0.05e-3)
    imaging = ImagingParameters(focus_depth=0.06)
    s = np.arange(-8e-3, 8e-3, imaging.wavelength / 4)
    # Faded ends echo nothing of their own.
    ends = np.sin(np.pi / 2 * np.clip((8e-3 - np.abs(s)) / 2e-3, 0, 1)) ** 2
    ours, theirs = [], []
    for a in np.deg2rad([0, *degrees]):
        ours.append(np.mean([specular_level(renderer, 0.0, rise) for rise in (a, -a)]))
        points = np.stack([s * np.cos(a), 0.06 + s * np.sin(a), np.zeros(len(s))], axis=1)
        envelope = middle_line(Transducer(), imaging, points, ends, 0.06)
        theirs.append(20 * np.log10(envelope.max()))
    relative = np.array(theirs[1:]) - theirs[0]
    assert (relative > -24).all()
    assert np.array(ours[1:]) - ours[0] == pytest.approx(relative, abs=3)


def test_needles_angle_law_matches_pymust():
    check_angle_law([4, 7])


@pytest.mark.slow
def test_needles_angle_law_matches_pymust_to_8_deg():
    check_angle_law(range(1, 9))


def test_the_beam_makes_the_needle_look_thick():
    """At -20 dB it is 4 mm thick across the frames, 60 mm deep: 1.82 widths at -6 dB."""
    needle = NeedleEchoParameters(**BARE, diffuse_db=-200.0)
    renderer = make_renderer(needle=needle, sector=0.05, depth=0.07, sample_pitch=0.05e-3)
    geometry = renderer.geometry
    offsets = np.arange(-4e-3, 4e-3, 0.2e-3)
    levels = []
    for offset in offsets:
        echo = needle_echo(renderer, needle_through([0, offset, -0.16], 0.0, 0.0))
        levels.append(np.abs(echo[geometry.frames // 2, geometry.lines // 2]).max())
    levels = np.array(levels) / max(levels)
    middle = len(offsets) // 2
    near = np.interp(0.1, levels[: middle + 1], offsets[: middle + 1])
    far = np.interp(-0.1, -levels[middle:], offsets[middle:])
    assert far - near == pytest.approx(4e-3, rel=0.2)
    i = round(0.06 / geometry.sample_pitch)
    assert far - near == pytest.approx(1.82 * FWHM_PER_SIGMA * renderer.beam.elevation[i], rel=0.1)


def test_needle_has_a_diffuse_floor():
    needle = NeedleEchoParameters(**BARE)
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


def test_needles_tip_shows_where_it_is():
    renderer = make_renderer(sector=0.4)
    tip = np.array([0.003, 0, -0.155])
    needle = Needle(np.array([tip - [0.05, 0, 0], tip]), 0.635e-3)
    grey = renderer.render(still(renderer), [needle] * 27, 1, 0)
    geometry = renderer.geometry
    k, j, i = (round(float(v)) for v in geometry.index((np.linalg.inv(DOWN) @ [*tip, 1])[:3], 1))
    window = grey[k, :, i - 4 : i + 3].max(axis=1).astype(int)
    assert window[j - 3 : j + 1].min() > 150
    assert window[j + 6 :].max() < 150


def test_a_needles_wall_runs_out_along_its_bevel():
    """Half of it is left in the middle of a bevel of 5 deg, 14.5 mm long."""
    needle = NeedleEchoParameters(**BARE, diffuse_db=-200.0, bevel_deg=5.0)
    renderer = make_renderer(needle=needle, sector=0.2)
    length = 2 * 0.635e-3 / np.tan(np.deg2rad(5))

    def level(beyond):
        """Amplitude below the middle of the probe, with the tip so far beyond it."""
        tip = np.array([beyond, 0, -0.16])
        echo = needle_echo(renderer, Needle(np.array([tip - [0.08, 0, 0], tip]), 0.635e-3))
        middle = renderer.geometry.lines // 2
        return np.abs(echo[13, middle - 1 : middle + 1]).max(axis=1).mean()

    assert level(length / 2) == pytest.approx(level(0.04) / 2, rel=0.05)
    assert level(length + 0.002) == pytest.approx(level(0.04), rel=0.05)
    assert level(-0.002) < 0.05 * level(0.04)


def test_a_blunt_needles_tip_is_a_point_of_the_wanted_level():
    needle = NeedleEchoParameters(
        **BARE | {"tip_db": 26.0}, specular_db=-200.0, diffuse_db=0.0, bevel_deg=90.0
    )
    renderer = make_renderer(needle=needle, sector=0.4, sample_pitch=0.05e-3)
    tip = np.array([0.0, 0, -0.16])
    echo = np.abs(needle_echo(renderer, Needle(np.array([tip - [0.05, 0, 0], tip]), 0.635e-3)))
    assert 20 * np.log10(echo.max()) == pytest.approx(26, abs=1.2)


def test_a_fibre_is_as_bright_as_a_needle():
    fibre = Fibre(start=[-0.01, 0, -0.16], end=[0.01, 0, -0.16], level_db=38.0)
    renderer = make_renderer(dataclasses.replace(DEEP, fibres=[fibre]), sector=0.2)
    echo = np.abs(renderer.tissue_echo(still(renderer), 1))
    assert 20 * np.log10(echo.max()) == pytest.approx(38, abs=3)


# --- contact, noise and grey levels ------------------------------------------------------------


@pytest.mark.parametrize(("gap", "coupled"), [(-0.004, True), (0.002, True), (0.005, False)])
def test_gel_bridges_gaps_up_to_its_thickness(gap, coupled):
    renderer = make_renderer(Tissue(), sector=0.05)
    pose = DOWN.copy()
    pose[2, 3] = gap
    grey = renderer.render(still(renderer, pose), [NOWHERE] * 27, 1, 0)
    middle = grey[13, :, 100:200]
    assert (middle.mean() > 60) == coupled
    assert (middle.max() < 30) == (not coupled)
    in_the_gel = grey[13, :, 3 : max(int(gap / 0.308e-3) - 3, 3)]
    assert in_the_gel.max(initial=0) < 30


def test_outer_lines_of_a_dome_lose_contact_first():
    renderer = make_renderer(Tissue())
    pose = DOWN.copy()
    pose[2, 3] = -0.5e-3  # barely pressed: gel bridges 3 mm, the dome falls away by 5 mm
    grey = renderer.render(still(renderer, pose), [NOWHERE] * 27, 1, 0)
    level = grey[13, :, 60:200].mean(axis=1)
    assert level[48] > 60
    assert level[0] < 10
    assert level[-1] < 10


def test_coupling_measures_the_way_along_the_line():
    box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.0]])
    origins = np.array([[0, 0, 0.002], [0, 0, 0.002], [0, 0, -0.01], [0.2, 0, 0.002]])
    slanted = np.array([np.sqrt(0.75), 0, -0.5])  # twice as far: 4 mm
    down = np.array([0, 0, -1.0])
    share = coupling(np.eye(4)[:3], origins, np.array([down, slanted, down, down]), box, 3e-3)
    assert share.tolist() == [1, 0, 1, 0]


def test_nothing_echoes_outside_the_phantom():
    renderer = make_renderer(Tissue(size=[0.24, 0.16, 0.05]), sector=0.3)
    pose = DOWN.copy()
    pose[2, 3] = -0.004
    echo = np.abs(renderer.tissue_echo(still(renderer, pose), 1))
    geometry = renderer.geometry
    y = geometry.position(*np.ogrid[: geometry.frames, : geometry.lines, : geometry.samples], 1)
    depth = y[..., 1] - 0.004 + 0.008  # below the top
    assert echo[depth > 0.054].max() == 0
    assert echo[(depth > 0.01) & (depth < 0.045)].mean() == pytest.approx(0.87, abs=0.05)


def test_grey_levels_are_rounded_to_nearest():
    rng = np.random.default_rng(0)
    level = rng.uniform(-40, 60, (20, 500))
    iq = (10 ** (level / 20) * np.exp(2j * np.pi * rng.random(level.shape))).astype(np.complex64)
    grey = np.empty(level.shape, np.uint8)
    silent = np.zeros(500, np.float32)
    compress(grey, iq, np.ones(20, np.float32), silent, np.uint64(0), 4.25, 89.25)
    exact = 4.25 * 20 * np.log10(np.abs(iq.astype(complex))) + 89.25
    clear = np.abs(exact - np.floor(exact) - 0.5) > 0.01
    assert clear.mean() > 0.9
    assert (grey[clear] == np.clip(np.rint(exact[clear]), 0, 255)).all()


def test_noise_is_rayleigh_and_repeatable():
    """Logarithm of a Rayleigh amplitude: mean -2.51 dB, standard deviation 5.57 dB."""

    def noise(key):
        grey = np.empty((100, 400), np.uint8)
        compress(
            grey,
            np.zeros(grey.shape, np.complex64),
            np.ones(100, np.float32),
            np.ones(400, np.float32),
            np.uint64(key),
            4.0,
            150.0,
        )
        return grey.astype(float)

    first = noise(1)
    assert (first.mean() - 150) / 4 == pytest.approx(-2.51, abs=0.2)
    assert first.std() / 4 == pytest.approx(5.57, abs=0.2)
    assert (first == noise(1)).all()
    assert abs(np.corrcoef(first.ravel(), noise(2).ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(first[1:].ravel(), first[:-1].ravel())[0, 1]) < 0.02


def test_default_grey_levels_leave_room_for_the_needle():
    """Tissue between 70 and 95; a needle across the beam from 215 up, hardly ever saturating."""
    renderer = make_renderer(focus_depth=0.025)
    for depth in (0.03, 0.05, 0.07):
        needle = needle_through([0, 0, -0.1 - depth], 0.3, 0.0)
        grey = renderer.render(still(renderer), [needle] * 27, 1, 0)
        assert 70 < grey[:5].mean() < 95
        assert grey.max() >= 215
        assert (grey == 255).sum() < 30


def test_noise_grows_with_depth_as_sound_is_attenuated():
    tissue = Tissue(size=[0.001, 0.001, 0.001], attenuation=0.5)  # nothing to see
    renderer = SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(gain=1.0),
        tissue=tissue,
        parameters=ScannerParameters(noise_db=-40.0, gel_thickness=1.0),
        seed=0,
    )
    grey = renderer.render(still(renderer), [NOWHERE] * 27, 1, 0).astype(float)
    levels = grey.mean(axis=(0, 1)) / 4.25
    # Both ways 0.5 dB/(cm MHz) x 3.3 MHz.
    assert levels[260] - levels[130] == pytest.approx(2 * 0.5 * 3.3 * 130 * 0.0308, abs=0.3)
