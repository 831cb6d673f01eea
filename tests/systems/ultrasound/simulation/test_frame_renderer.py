"""Echoes of single points, against the geometry and the point spread function."""

import dataclasses

import numpy as np
import pytest
from pymust_referee import middle_line
from renderers import DEEP, DOWN, about, correlation, make_renderer, shift, still, upright

from sonoservo.systems.ultrasound.beam import FWHM_PER_SIGMA
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation import frame_renderer
from sonoservo.systems.ultrasound.simulation.kernels.blocks import BLOCKS, ScattererTile
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Tissue
from sonoservo.systems.ultrasound.transducer import Transducer


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
    offsets = sigma * np.arange(3, 8.1, 0.5)

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


def speckle(renderer, sweeps):
    rng = np.random.default_rng(3)
    frames = renderer.geometry.frames
    places = rng.uniform(-0.04, 0.04, (sweeps, frames, 3))
    poses = (upright(renderer, np.eye(4), each) for each in places)
    return np.concatenate([renderer.tissue_echo(X, 1) for X in poses])


def test_speckle_snr_is_that_of_four_scatterers_a_cell():
    """Four scatterers in a resolution cell: 1.79, from 20 to 120 mm; mean intensity 1."""
    deep = make_renderer(depth=0.13)
    amplitude = np.abs(speckle(deep, 2))
    depth = deep.geometry.sample_pitch * np.arange(deep.geometry.samples)
    for centre in np.arange(0.02, 0.121, 0.02):
        slab = amplitude[:, :, np.abs(depth - centre) < 4e-3].astype(float)
        assert slab.mean() / slab.std() == pytest.approx(1.79, abs=0.05)
        assert (slab**2).mean() == pytest.approx(1, rel=0.05)


def test_intensity_moments_are_those_of_a_k_distribution():
    """<I^2> / <I>^2 = 2 + 1/N = 2 (1 + 1/nu) with nu = 2 N; Zhao 2012 has nu = 10."""
    tissue = dataclasses.replace(DEEP, scatterers_per_cell=2)
    intensity = np.abs(speckle(make_renderer(tissue, sector=0.2, depth=0.07), 4)) ** 2
    intensity = intensity[:, :, 60:].astype(float)
    moment = (intensity**2).mean() / intensity.mean() ** 2
    assert moment == pytest.approx(2.5, rel=0.04)


def autocovariance(intensity, axis):
    """At lag 1, relative to lag 0."""
    deviation = np.moveaxis(intensity - intensity.mean(), axis, 0)
    return (deviation[1:] * deviation[:-1]).mean() / (deviation**2).mean()


def test_speckle_is_as_large_as_the_point_spread_function():
    """The intensity's autocovariance is as wide as the point spread function along a frame."""
    renderer = make_renderer(depth=0.11)
    geometry, beam = renderer.geometry, renderer.beam
    rng = np.random.default_rng(3)
    places = rng.uniform(-0.04, 0.04, (3, 3))
    poses = (still(renderer, DOWN @ shift(*each)) for each in places)
    echoes = np.array([renderer.tissue_echo(X, 1) for X in poses])
    for depth in (0.06, 0.10):
        i = round(depth / geometry.sample_pitch)
        intensity = np.abs(echoes[..., i - 6 : i + 7].astype(complex)) ** 2
        spacing = geometry.line_pitch * (geometry.array_radius + depth)
        width = FWHM_PER_SIGMA * spacing / np.sqrt(-2 * np.log(autocovariance(intensity, 2)))
        assert width == pytest.approx(FWHM_PER_SIGMA * beam.lateral[i], rel=0.1)
        width = geometry.sample_pitch / np.sqrt(-2 * np.log(autocovariance(intensity, 3)))
        assert width == pytest.approx(beam.axial, rel=0.1)
