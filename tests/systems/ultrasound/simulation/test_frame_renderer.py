"""Echoes of single points, against the geometry and the point spread function."""

import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line
from renderers import DEEP, DOWN, about, correlation, make_renderer, shift, still, upright

from sonoservo.systems.ultrasound.beam import FWHM_PER_SIGMA, transmitted_spectrum
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation import frame_renderer
from sonoservo.systems.ultrasound.simulation.kernels.blocks import BLOCKS, ScattererTile
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Tissue
from sonoservo.systems.ultrasound.transducer import Transducer


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
    monkeypatch.setattr(frame_renderer, "scatterer_tile", lambda density, rng: tile)
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


def test_the_arc_of_a_point_across_the_frames_is_that_of_the_beam():
    """Level of the side lobes in elevation and their fall, against PyMUST."""
    renderer = make_renderer(sector=0.1, sample_pitch=0.1e-3)
    geometry, imaging = renderer.geometry, ImagingParameters(focus_depth=0.06)
    middle, sigma = geometry.frames // 2, renderer.beam.elevation[round(0.06 / 0.1e-3)]
    offsets = sigma * np.arange(0, 8.1, 0.4)

    def ours(offset):
        echo = np.zeros(geometry.shape, np.complex64)
        point = np.array([[0.0, offset, -0.16]])
        renderer.add_scatterers(echo, still(renderer), point, np.ones(1, complex), 1)
        return np.abs(echo[middle]).max()

    def theirs(offset):
        return middle_line(Transducer(), imaging, [[0.0, 0.06, offset]], [1.0], 0.06).max()

    def bands(level):
        power = np.array([level(offset) for offset in offsets]) ** 2 / level(0.0) ** 2
        x = offsets / sigma
        return [
            10 * np.log10(power[(x >= low) & (x < high)].mean())
            for low, high in ((3, 5), (5, 7), (7, 8.1))
        ]

    assert bands(ours) == pytest.approx(bands(theirs), abs=2.5)


@pytest.fixture(scope="module")
def deep():
    return make_renderer(depth=0.13)


@pytest.fixture(scope="module")
def small():
    """A narrow sector, for many sweeps."""
    return make_renderer(sector=0.2, depth=0.07)


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
