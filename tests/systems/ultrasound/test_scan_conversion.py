from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from scipy.ndimage import map_coordinates

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid, sector_bounds
from sonoservo.systems.ultrasound.scan_converter import ScanConversionParameters, ScanConverter

GEOMETRY = SweepGeometry(
    0.04, 0.02725, np.deg2rad(1.2), np.deg2rad(2.9), 1e-3, lines=48, frames=13, samples=80,
    frame_period=0.02,
)  # fmt: skip


def positions(grid):
    return np.stack(np.meshgrid(*(grid.axis(a) for a in range(3)), indexing="ij"), axis=-1)


def make_sweep(samples, direction=1):
    poses = np.tile(np.eye(4), (GEOMETRY.frames, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1e-3, GEOMETRY.frames)
    times = 0.02 * np.arange(GEOMETRY.frames)[::direction]
    return Sweep(samples, SweepMotion(GEOMETRY, direction, times, poses))


def test_both_motor_directions_see_a_still_object_at_the_same_place():
    """The motor never stops: without each line's own angle they differ by a frame pitch."""
    grid = make_grid(GEOMETRY, 1.5e-3)
    conversion = ScanConversion(GEOMETRY, grid)
    k, j, i = np.meshgrid(*(np.arange(n) for n in GEOMETRY.shape), indexing="ij")
    centroids = []
    places = positions(grid).reshape(-1, 3)
    for direction in (1, -1):
        p_P = GEOMETRY.position(k, j, i, direction)
        distance = np.linalg.norm(p_P - np.array([0.018, 0.05, 0.004]), axis=-1)
        samples = np.round(200 * np.exp(-((distance / 6e-3) ** 2))).astype(np.uint8)
        weights = conversion.convert(samples, direction).astype(float)
        centroids.append(np.average(places, axis=0, weights=weights.ravel()))
    assert np.linalg.norm(centroids[0] - centroids[1]) < 0.1e-3


@pytest.mark.parametrize(("radii", "direction"), [((0.04, 0.02725), -1), ((0.0, 0.0), 1)])
def test_agrees_with_scipy_on_uneven_grids(radii, direction):
    """No row of the grid is cut short: also around the probe's dome, and to a single point."""
    geometry = replace(GEOMETRY, array_radius=radii[0], motor_radius=radii[1])
    grid = make_grid(geometry, [2.3e-3, 0.9e-3, 1.3e-3], [-0.04, -0.02, -0.03], [0.06, 0.09, 0.05])
    samples = np.random.default_rng(5).integers(1, 256, geometry.shape, np.uint8)
    volume = ScanConversion(geometry, grid).convert(samples, direction)
    p_P = positions(grid)
    inside = geometry.contains(p_P)
    assert np.mean((volume > 0) == inside) > 0.9999
    both = inside & (volume > 0)
    coordinates = [c[both] for c in geometry.index(p_P, direction)]
    expected = map_coordinates(samples.astype(float), coordinates, order=1)
    assert np.abs(volume[both] - expected).max() < 0.6


def seen_by_a_moving_probe(p_W, direction, velocity, turn_rate=0.0):
    """Sweep over a soft ball in the world, every frame from the probe's pose at its time."""
    times = 0.02 * np.arange(GEOMETRY.frames)[::direction]
    poses = np.tile(np.eye(4), (GEOMETRY.frames, 1, 1))
    poses[:, :3, 3] = [0.1, 0.2, 0.3] + times[:, np.newaxis] * velocity
    for pose, time in zip(poses, times, strict=True):
        pose[:3, :3] = RotationMatrix.MakeYRotation(turn_rate * time).matrix()
    j, i = np.meshgrid(np.arange(GEOMETRY.lines), np.arange(GEOMETRY.samples), indexing="ij")
    samples = np.zeros(GEOMETRY.shape, np.uint8)
    for k, pose in enumerate(poses):
        at_W = GEOMETRY.position(k, j, i, direction) @ pose[:3, :3].T + pose[:3, 3]
        distance = np.linalg.norm(at_W - p_W, axis=-1)
        samples[k] = np.round(250 * np.exp(-((distance / 4e-3) ** 2)))
    return Sweep(samples, SweepMotion(GEOMETRY, direction, times, poses))


@pytest.mark.parametrize(
    ("direction", "velocity", "turn_rate", "p_P"),
    [
        (1, [0.02, 0, 0], 0.0, [0.012, 0.045, 0.01]),
        (-1, [0, 0, 0.02], 0.0, [-0.015, 0.05, -0.009]),
        (-1, [0.01, -0.01, -0.01], np.deg2rad(10), [0.012, 0.045, 0.01]),
    ],
)
def test_a_still_target_seen_by_a_moving_probe_lands_where_it_is(
    direction, velocity, turn_rate, p_P
):
    middle = RigidTransform(
        RotationMatrix.MakeYRotation(0.12 * turn_rate),
        np.array([0.1, 0.2, 0.3]) + 0.12 * np.array(velocity),
    )
    sweep = seen_by_a_moving_probe(middle.multiply(p_P), direction, velocity, turn_rate)
    grid = make_grid(GEOMETRY, 1e-3)
    places = positions(grid).reshape(-1, 3)
    error = {}
    for compensate in (False, True):
        volume = ScanConversion(GEOMETRY, grid, compensate_motion=compensate)(sweep)
        weights = volume.intensities.astype(float).ravel()
        shown = np.average(places, axis=0, weights=weights)
        error[compensate] = np.linalg.norm(shown - p_P)
    assert error[True] < 0.2e-3
    assert error[False] > 0.5e-3
    (p_W,), (time,) = volume.to_world(shown[np.newaxis])
    assert np.linalg.norm(p_W - middle.multiply(p_P)) < 0.2e-3
    assert abs(time - volume.time) > 0.03


def test_compensation_leaves_a_constant_constant_and_a_still_probe_alone():
    grid = make_grid(GEOMETRY, 1.7e-3)
    conversion = ScanConversion(GEOMETRY, grid, compensate_motion=True)
    samples = np.full(GEOMETRY.shape, 100, np.uint8)
    motion = seen_by_a_moving_probe([0, 0, 0], 1, [0.02, 0.01, 0.02], 0.3).motion
    assert set(np.unique(conversion(Sweep(samples, motion)).intensities)) == {0, 100}

    samples = np.random.default_rng(6).integers(0, 256, GEOMETRY.shape, np.uint8)
    at_rest = seen_by_a_moving_probe([0, 0, 0], -1, [0, 0, 0]).motion
    volume = conversion(Sweep(samples, at_rest))
    difference = volume.intensities.astype(int) - conversion.convert(samples, -1)
    assert np.mean(difference != 0) < 0.01
    assert np.mean(np.abs(difference) > 1) < 1e-3  # at the sector's edge alone


@pytest.mark.parametrize(("velocity", "turn_rate"), [([0, -0.02, 0], 0), ([-0.01, 0, 0.01], 0.5)])
def test_no_element_that_a_moving_probe_saw_is_skipped(monkeypatch, velocity, turn_rate):
    sweep = seen_by_a_moving_probe([0, 0, 0], 1, velocity, turn_rate)
    sweep = replace(sweep, samples=np.full(GEOMETRY.shape, 100, np.uint8))
    conversion = ScanConversion(GEOMETRY, make_grid(GEOMETRY, 2e-3), compensate_motion=True)
    fast = conversion(sweep).intensities

    def everything(sector, margin, x, y, z):
        return np.tile(np.array([[0, len(z)], [0, 0]], np.int32), (len(x), len(y), 1, 1))

    monkeypatch.setattr("sonoservo.systems.ultrasound.scan_conversion.rows_in_sector", everything)
    np.testing.assert_array_equal(fast, conversion(sweep).intensities)


def test_a_sector_too_wide_is_named():
    with pytest.raises(ValueError, match="line_pitch: .* the sector reaches to 1.35 rad"):
        ScanConversion(replace(GEOMETRY, lines=140, frame_period=0.1), make_grid(GEOMETRY, 2e-3))


def test_leaf_gives_the_middle_pose_and_passes_on_what_is_missing():
    leaf = ScanConverter(
        geometry=GEOMETRY, parameters=ScanConversionParameters(spacing=[2e-3, 2e-3, 2e-3])
    )
    context = leaf.CreateDefaultContext()
    port = leaf.GetInputPort("sweep")
    port.FixValue(context, Value[object](NotFound("not yet")))
    assert leaf.GetOutputPort("volume").Eval(context).reason == "not yet"
    port.FixValue(context, Value[object](make_sweep(np.zeros(GEOMETRY.shape, np.uint8), -1)))
    volume = leaf.GetOutputPort("volume").Eval(context)
    assert isinstance(volume.X_WP, RigidTransform)
    assert volume.X_WP.translation()[0] == pytest.approx(0.5e-3)
    assert volume.time == pytest.approx(0.12)


@pytest.mark.parametrize("spacing", [[1e-3], [1e-3, 1e-3, 6e-3]])
def test_bad_spacing_is_named(spacing):
    with pytest.raises(ValueError, match="spacing: .* must be three voxel sizes"):
        ScanConversionParameters(spacing=spacing)


def test_bounds_contain_every_sample():
    k, j, i = np.meshgrid(*(np.arange(n) for n in GEOMETRY.shape), indexing="ij")
    lower, upper = sector_bounds(GEOMETRY)
    p_P = GEOMETRY.position(k, j, i, 1)
    assert (p_P >= lower - 1e-4).all()
    assert (p_P <= upper + 1e-4).all()
