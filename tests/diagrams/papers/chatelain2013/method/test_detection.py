import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from scipy.optimize import minimize
from synthetic_volumes import ENTRY, GEOMETRY, Scene

from sonoservo.diagrams.papers.chatelain2013.method.detection import (
    PublishedDetectionParameters,
    closest_face,
    detect_as_published,
    geometric_median,
    top_differences,
)
from sonoservo.diagrams.papers.chatelain2013.method.insertion_detector import InsertionDetector
from sonoservo.systems.signals import NotFound, Volume
from sonoservo.systems.tracking import VolumeMemory

INWARD = np.array([1, 0.2, 0.1]) / np.linalg.norm([1, 0.2, 0.1])
SCENE = Scene(seed=1, spacing=1.0e-3, balls=[([0.01, 0.06, 0.005], 2e-3)])
SHAPE = (17, 13, 11)
COORDINATES = st.integers(-40, 40).map(lambda n: 1e-3 * n)
PARAMETERS = PublishedDetectionParameters(candidate_volume=5e-9)


def detect(volume, previous, **changes):
    parameters = dataclasses.replace(PARAMETERS, **changes)
    return detect_as_published(volume, previous, parameters)


@pytest.fixture(scope="module")
def before():
    return SCENE.volume(0)


@pytest.fixture(scope="module")
def entered():
    return SCENE.volume(2, lambda time: (ENTRY, ENTRY + 5e-3 * INWARD))


def test_one_volume_shows_the_entry(before, entered):
    found = detect(entered, before)
    assert np.linalg.norm(found.p_WEntry - ENTRY) < 4e-3
    assert 0 < (found.p_WMedian - ENTRY) @ INWARD < 5e-3
    np.testing.assert_array_equal(found.p_WTip, found.p_WMedian)
    assert found.time == entered.time


def test_the_variance_decides(before, entered):
    unlike = [Scene(seed=seed, spacing=1e-3).volume(0) for seed in (1, 2)]
    assert "spread" in detect(*unlike).reason
    assert "spread" in detect(entered, before, max_std=0.1e-3).reason


def test_the_median_must_be_near_its_face(before, entered):
    assert "inside" in detect(entered, before, max_depth=0.1e-3).reason


def test_nothing_moved(before):
    still = dataclasses.replace(before, intensities=np.full(before.intensities.shape, 9, np.uint8))
    assert "nothing changed" in detect(still, still).reason
    moved = dataclasses.replace(before, X_WP=RigidTransform([0, 1.5e-3, 0]).multiply(before.X_WP))
    assert "probe moved" in detect(moved, before).reason
    small = dataclasses.replace(before, intensities=before.intensities[:9])
    assert "grid" in detect(small, before).reason


@pytest.mark.parametrize("motion", [True, False])
def test_probe_and_far_end_are_faces(before, motion):
    volume = before if motion else dataclasses.replace(before, motion=None)
    middle = GEOMETRY.position(12, 48, 8, 1)
    face = closest_face(volume, middle)
    assert face[1] < middle[1]
    assert np.linalg.norm(face - middle) < 4e-3
    deep = GEOMETRY.position(12, 48, GEOMETRY.samples - 8, 1)
    assert abs(closest_face(volume, deep)[1] - deep[1]) > 1e-3


@pytest.mark.parametrize(("line", "direction"), [(0, 0), (GEOMETRY.lines - 1, 1)])
def test_side_of_the_sector(line, direction):
    volume = SCENE.volume(direction)
    on_side = GEOMETRY.position(12, line, 150, volume.motion.direction)
    inside = GEOMETRY.position(12, abs(line - 5), 150, volume.motion.direction)
    np.testing.assert_allclose(closest_face(volume, inside), on_side, atol=1e-9)


def test_side_of_a_sector_of_unknown_motion_is_where_its_voxels_end(before):
    volume = dataclasses.replace(before, motion=None)
    on_side = GEOMETRY.position(12, 0, 150, 1)
    inside = GEOMETRY.position(12, 5, 150, 1)
    side = closest_face(volume, inside)
    # Along X, not along the arc: from 5 lines within, that is nearly the same.
    assert np.linalg.norm(side - on_side) < 3e-3
    np.testing.assert_allclose(side[1:], inside[1:])


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_differences_are_the_order_statistic(dtype):
    rng = np.random.default_rng(0)
    a, b = (rng.integers(1, 255, SHAPE).astype(dtype) for _ in range(2))
    index, threshold = top_differences(a, b, 50)
    difference = np.abs(a.astype(float) - b)
    assert len(np.unique(index, axis=0)) == 50
    assert threshold == np.sort(difference.ravel())[-50]
    assert difference[tuple(index.T)].min() == threshold


def test_ties_are_chosen_from_the_whole_volume():
    a, b = np.full(SHAPE, 9, np.uint8), np.full(SHAPE, 4, np.uint8)
    index, threshold = top_differences(a, b, 200)
    assert (len(index), threshold) == (200, 5)
    np.testing.assert_allclose(index.mean(axis=0), (np.array(SHAPE) - 1) / 2, atol=1.2)


def test_outside_a_moving_sector_is_no_change():
    a, b = np.full(SHAPE, 30, np.uint8), np.full(SHAPE, 30, np.uint8)
    b[0] = 0
    b[5, 5, 5] = 40
    index, _ = top_differences(a, b, 5, seen=(a > 0, b > 0))
    np.testing.assert_array_equal(index, [[5, 5, 5]])


def cost(y, points):
    return np.linalg.norm(points - y, axis=1).sum()


@settings(max_examples=30)
@given(arrays(float, st.tuples(st.integers(1, 12), st.just(3)), elements=COORDINATES))
def test_no_other_point_is_closer_than_the_median(points):
    median = geometric_median(points)
    best = min(
        minimize(cost, start, args=(points,), method="Nelder-Mead").fun
        for start in (points.mean(axis=0), median)
    )
    best = min(best, *(cost(p, points) for p in points))
    assert cost(median, points) <= best + 1e-5


def test_median_from_a_start_at_a_point_that_is_not_the_median():
    points = np.array([[0, 0.0], [-3, 0], [-3, 0], [-3, 0], [-3, 0], [12, 0]])
    np.testing.assert_array_equal(points.mean(axis=0), points[0])
    np.testing.assert_allclose(geometric_median(points), [-3, 0], atol=1e-3)


def test_no_points_have_no_median():
    with pytest.raises(ValueError, match="points"):
        geometric_median(np.zeros((0, 3)))


def test_the_leaf_passes_on_what_is_missing(before, entered):
    detector = InsertionDetector(parameters=PARAMETERS)
    context = detector.CreateDefaultContext()
    volume = detector.GetInputPort("volume")
    previous = detector.GetInputPort("previous_volume")
    detection = detector.GetOutputPort("detection")
    previous.FixValue(context, Value[object](NotFound("no earlier one")))
    volume.FixValue(context, Value[object](NotFound("no volume")))
    assert detection.Eval(context).reason == "no volume"
    volume.FixValue(context, Value[object](entered))
    assert detection.Eval(context).reason == "no earlier one"
    previous.FixValue(context, Value[object](before))
    assert detection.Eval(context)
    volume.FixValue(context, Value[object]("scan"))
    with pytest.raises(TypeError, match="'volume'"):
        detection.Eval(context)


def test_memory_is_the_same_before_and_after_its_event():
    memory = VolumeMemory(period=1.0)
    context = memory.CreateDefaultContext()
    zeros = np.zeros((2, 2, 2), np.uint8)
    volumes = [
        Volume(zeros, np.zeros(3), np.full(3, 1e-3), RigidTransform(), float(k)) for k in range(7)
    ]
    for k, volume in enumerate(volumes):
        memory.GetInputPort("volume").FixValue(context, Value[object](volume))
        for _ in range(3):
            previous = memory.GetOutputPort("previous_volume").Eval(context)
            assert previous is volumes[k - 1] if k else not previous
            memory.ExecuteForcedEvents(context)


def test_memory_compares_sweeps_of_one_direction():
    memory = VolumeMemory(same_direction=True, period=1.0)
    context = memory.CreateDefaultContext()
    volumes = [SCENE.volume(k) for k in range(4)]
    for volume in volumes:
        memory.GetInputPort("volume").FixValue(context, Value[object](volume))
        memory.ExecuteForcedEvents(context)
    assert memory.GetOutputPort("previous_volume").Eval(context) is volumes[1]
