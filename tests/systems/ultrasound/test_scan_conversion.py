import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from scipy.ndimage import map_coordinates

from sonoservo.systems.ultrasound.scan_conversion import (
    ScanConversion,
    make_grid,
    sector_bounds,
)
from sonoservo.systems.ultrasound.scan_converter import ScanConversionParameters, ScanConverter
from sonoservo.systems.ultrasound.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.values import NotFound

GEOMETRY = SweepGeometry(
    array_radius=0.04,
    motor_radius=0.02725,
    line_pitch=np.deg2rad(1.2),
    frame_pitch=np.deg2rad(2.9),
    sample_pitch=1e-3,
    lines=48,
    frames=13,
    samples=80,
    frame_period=0.02,
)


def positions(grid):
    return np.stack(np.meshgrid(*(grid.axis(a) for a in range(3)), indexing="ij"), axis=-1)


def make_sweep(samples, direction=1):
    poses = np.tile(np.eye(4), (GEOMETRY.frames, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1e-3, GEOMETRY.frames)
    times = 0.02 * np.arange(GEOMETRY.frames)[::direction]
    return Sweep(samples, SweepMotion(GEOMETRY, direction, times, poses))


@pytest.mark.parametrize("direction", [1, -1])
def test_agrees_with_scipy_interpolation_at_the_exact_coordinates(direction):
    samples = np.random.default_rng(3).integers(0, 256, GEOMETRY.shape, np.uint8)
    grid = make_grid(GEOMETRY, 1.7e-3)
    volume = ScanConversion(GEOMETRY, grid).convert(samples, direction)
    p_P = positions(grid)
    inside = GEOMETRY.contains(p_P)
    coordinates = [c[inside] for c in GEOMETRY.index(p_P, direction)]
    expected = map_coordinates(samples.astype(float), coordinates, order=1)
    both = volume[inside] > 0
    difference = np.abs(volume[inside][both] - expected[both])
    assert both.mean() > 0.99
    assert difference.max() < 0.9
    assert difference.mean() < 0.27  # rounding alone: 1/4


def test_a_constant_stays_constant_inside_and_zero_outside():
    grid = make_grid(GEOMETRY, 1.7e-3)
    volume = ScanConversion(GEOMETRY, grid).convert(np.full(GEOMETRY.shape, 100, np.uint8), 1)
    assert set(np.unique(volume)) == {0, 100}
    assert np.mean((volume > 0) == GEOMETRY.contains(positions(grid))) > 0.999


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


def test_a_region_equals_the_same_part_of_the_whole():
    samples = np.random.default_rng(4).integers(0, 256, GEOMETRY.shape, np.uint8)
    whole_grid = make_grid(GEOMETRY, 1e-3)
    whole = ScanConversion(GEOMETRY, whole_grid).convert(samples, 1)
    low, high = whole_grid.origin + 1e-3 * np.array([[20, 30, 10], [40, 60, 25]])
    part_grid = make_grid(GEOMETRY, 1e-3, low, high)
    part = ScanConversion(GEOMETRY, part_grid).convert(samples, 1)
    np.testing.assert_allclose(part_grid.origin, low)
    difference = part.astype(int) - whole[20:41, 30:61, 10:26]
    assert np.abs(difference).max() <= 1


def test_bounds_contain_every_sample():
    k, j, i = np.meshgrid(*(np.arange(n) for n in GEOMETRY.shape), indexing="ij")
    lower, upper = sector_bounds(GEOMETRY)
    p_P = GEOMETRY.position(k, j, i, 1)
    assert (p_P >= lower - 1e-4).all()
    assert (p_P <= upper + 1e-4).all()


@pytest.mark.parametrize("spacing", [[1e-3], [1e-3, 1e-3, 0.0], [1e-3, 1e-3, 6e-3]])
def test_bad_spacing_is_named(spacing):
    with pytest.raises(ValueError, match="spacing: .* must be three voxel sizes"):
        ScanConversionParameters(spacing=spacing)


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
    port.FixValue(context, Value[object]("a wrong value"))
    with pytest.raises(TypeError, match="received a str; Sweep or NotFound is wanted"):
        leaf.GetOutputPort("volume").Eval(context)
