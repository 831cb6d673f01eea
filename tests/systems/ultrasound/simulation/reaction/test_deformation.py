"""Deformation of the tissue: its geometry, and the motion of the rendered speckle."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from renderers import CLEAN, NOWHERE
from speckle_motion import speckle_motion

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation, indentation
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.structures.kinds import Calcification, FatLayer, Vessel
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

DOWN = RotationMatrix(RollPitchYaw(-np.pi / 2, 0, 0))
PRESSED = RigidTransform(DOWN, [0, 0, -4e-3])
PRESSING = Deformation(indentation(PRESSED, 33e-3))
ALONG = np.array([[-0.06, 0, -0.035], [0.02, 0, -0.035]])
IMAGING = ImagingParameters(frames=3, volume_rate=10, depth=0.07, sector=0.6)


def make_renderer(tissue=None, **changes):
    return SweepRenderer(
        transducer=Transducer(),
        imaging=replace(IMAGING, **changes),
        tissue=tissue or Tissue(seed=1),
        parameters=CLEAN,
        seed=0,
    )


@pytest.fixture(scope="module")
def renderer():
    return make_renderer()


def image(renderer, deformation=None, times=None):
    """Middle frame of a sweep at rest, whose plane is vertical."""
    poses = np.tile(PRESSED.GetAsMatrix4(), (3, 1, 1))
    deformations = None if deformation is None else [deformation] * 3
    return renderer.tissue_echo(poses, 1, times, deformations)[1]


def place(renderer, line, sample):
    """Point of T, in m, at a line and a sample of the middle frame."""
    return PRESSED.multiply(renderer.geometry.position(1, line, sample, 1))


def polar(renderer, point):
    """Path across the lines, and depth along them, of a point of T, in m."""
    x, y, _ = PRESSED.inverse().multiply(point)
    radius = renderer.geometry.array_radius
    r = np.hypot(x, y + radius)
    return np.array([np.arctan2(x, y + radius) * r, r - radius])


def motion(renderer, deformation, line, depth, half=(4, 8)):
    """Motion of the tissue at a place, and that of the speckle there, across and along, in m."""
    geometry = renderer.geometry
    sample = round(depth / geometry.sample_pitch)
    point = place(renderer, line, sample)
    end = deformation.moved(point[np.newaxis])[0]
    path = polar(renderer, end) - polar(renderer, point)
    steps = np.array([geometry.line_pitch * (geometry.array_radius + depth), geometry.sample_pitch])
    before, after = np.abs(image(renderer)), np.abs(image(renderer, deformation))
    start = np.round(path / steps).astype(int)
    *moved, height = speckle_motion(before, after, line, sample, half, (4, 8), start)
    return path, moved * steps, height


def check_motion(renderer, deformation, line, depth):
    """Compare both motions, and return that of the tissue."""
    path, found, height = motion(renderer, deformation, line, depth)
    assert height > 0.5
    assert abs(found[0] - path[0]) < 0.3e-3
    assert abs(found[1] - path[1]) < 0.1e-3
    return path


def test_depth_of_the_indentation_is_that_of_the_deepest_point_of_the_dome():
    pressed = indentation(PRESSED, 33e-3)
    assert (pressed.x, pressed.y) == pytest.approx((0, 0), abs=1e-12)
    assert pressed.depth == pytest.approx(4e-3)
    assert pressed.radius == pytest.approx(np.sqrt(4e-3 * 33e-3))
    # A probe rolled about its face's centre touches beside it.
    tilt = np.deg2rad(10)
    tilted = indentation(
        RigidTransform(RotationMatrix.MakeYRotation(tilt) @ DOWN, [0.01, 0.02, -4e-3]), 33e-3
    )
    assert tilted.x == pytest.approx(0.01 + 33e-3 * np.sin(tilt))
    assert tilted.y == pytest.approx(0.02)
    assert tilted.depth == pytest.approx(4e-3 + 33e-3 * (1 - np.cos(tilt)))
    assert indentation(RigidTransform(DOWN, [0, 0, 1e-3]), 33e-3).depth == 0


def test_needle_moves_with_the_tissue_pressed_by_the_probe_but_not_by_its_own_push():
    needle = Needle(ALONG, 0.6e-3, roll=0.3)
    pushing = Deformation(PRESSING.indentation, ALONG, drag=1e-3, hole_radius=0.6e-3)
    moved = pushing.moved_needle(needle)
    np.testing.assert_allclose(moved.tip, PRESSING.moved(ALONG[1:])[0])
    assert moved.roll == 0.3
    # Below the face by as much as the tissue; 60 mm aside by little.
    middle = moved.shaft[np.abs(moved.shaft[:, 0]).argmin(), 2]
    assert -1.6e-3 < middle + 0.035 < -0.9e-3
    assert abs(moved.shaft[0, 2] + 0.035) < 0.5e-3
    assert Deformation(shaft=ALONG, drag=1e-3).moved_needle(needle) is needle
    assert pushing.moved_needle(NOWHERE) is NOWHERE


@pytest.mark.parametrize(("line", "depth"), [(49, 0.02), (20, 0.05)])
def test_speckle_moves_with_the_indentation(renderer, line, depth):
    across, down = check_motion(renderer, PRESSING, line, depth)
    assert np.hypot(across, down) > 0.6e-3


@pytest.mark.parametrize("drag", [0.5e-3, -2e-3])
def test_speckle_beside_the_needle_moves_with_the_drag(renderer, drag):
    deformation = Deformation(shaft=ALONG, drag=drag)
    for depth in (0.027, 0.037):
        across, _ = check_motion(renderer, deformation, 38, depth)
        assert abs(across) > 0.3 * abs(drag)


@pytest.mark.parametrize(("depth", "way"), [(0.028, -1), (0.034, 1)])
def test_speckle_gives_way_to_a_needle_through_the_image(renderer, depth, way):
    found = []
    for line in (18, 28, 38, 48, 58):
        x, _, z = place(renderer, line, round(0.031 / renderer.geometry.sample_pitch))
        across = np.array([[x, -0.05, z], [x, 0.05, z]])
        deformation = Deformation(shaft=across, hole_radius=1e-3)
        found.append(motion(renderer, deformation, line, depth, half=(3, 5))[:2])
    expected, measured = np.mean(found, axis=0)[:, 1]
    assert way * expected > 0.1e-3
    assert measured == pytest.approx(expected, abs=0.1e-3)


@pytest.mark.parametrize(
    "contents",
    [
        {"balls": [Ball(centre=[0.004, 0, -0.03], radius=0.5e-3, level_db=40)]},
        {"structures": [Calcification(centre=[0.004, 0, -0.03], radius=0.6e-3, level_db=50)]},
    ],
    ids=["ball", "calcification"],
)
def test_bright_objects_move_with_the_tissue(contents):
    own = make_renderer(Tissue(seed=1, **contents))
    bare = make_renderer()
    point = np.array([0.004, 0, -0.03])
    found = []
    for deformation in (Deformation(), PRESSING):
        echo = np.abs(image(own, deformation) - image(bare, deformation)) ** 2
        line, sample = np.unravel_index(echo.argmax(), echo.shape)
        box = np.s_[line - 6 : line + 7, sample - 10 : sample + 11]
        weights = echo[box] / echo[box].sum()
        j, i = np.indices(echo.shape)
        found.append(polar(own, place(own, (j[box] * weights).sum(), (i[box] * weights).sum())))
    expected = polar(own, PRESSING.moved(point[np.newaxis])[0]) - polar(own, point)
    across, down = found[1] - found[0] - expected
    assert abs(across) < 0.3e-3
    assert abs(down) < 0.1e-3


def test_blood_decorrelates_as_it_passes_through_the_beam():
    speed = 2e-3
    vessel = Vessel(
        path=[[-0.05, 0, -0.035], [0.05, 0, -0.035]], radius=6e-3, lumen_db=0, level_db=-60,
        diffuse_db=-60, pulsation=0, attenuation=0.5, flow_speed=speed,
    )  # fmt: skip
    own = make_renderer(Tissue(seed=1, structures=[vessel]))
    middle = round(0.031 / own.geometry.sample_pitch)
    half = round(3e-3 / own.geometry.sample_pitch)
    lumen = np.s_[20:-20, middle - half : middle + half]
    width = own.beam.lateral[
        np.abs(own.geometry.sample_pitch * np.arange(own.geometry.samples) - 0.06).argmin()
    ]
    at_rest = image(own, times=np.zeros(3))
    for time in (0.2, 0.8):
        later = image(own, times=np.full(3, time))
        a, b = at_rest[lumen], later[lumen]
        found = abs(np.vdot(a, b)) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real)
        expected = np.exp(-((speed * time) ** 2) / (4 * width**2))
        assert found == pytest.approx(expected, abs=0.1)
        # The tissue around it is at rest.
        np.testing.assert_allclose(later[:, : middle - 3 * half], at_rest[:, : middle - 3 * half])


@pytest.mark.slow
def test_speckle_moves_with_the_indentation_behind_fat():
    fat = make_renderer(Tissue(seed=1, fat=FatLayer(thickness=0.01)))
    check_motion(fat, PRESSING, fat.geometry.lines // 2, 0.04)
