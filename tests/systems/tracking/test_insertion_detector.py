import dataclasses

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from synthetic_volumes import GEOMETRY, Scene, entry_on_side

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.field_of_view import closest_side
from sonoservo.systems.tracking.insertion_detector import (
    InsertionDetector,
    InsertionDetectorParameters,
    detect_insertion,
)
from sonoservo.systems.tracking.volume_memory import VolumeMemory

PARAMETERS = InsertionDetectorParameters()
ENTRY = entry_on_side()
INWARD = np.array([1, 0.2, 0.1]) / np.linalg.norm([1, 0.2, 0.1])
SCENE = Scene(seed=1, spacing=1.0e-3, balls=[([0.01, 0.06, 0.005], 2e-3)])


def needle(length):
    return lambda time: (ENTRY, ENTRY + length * INWARD)


@pytest.fixture(scope="module")
def before():
    return SCENE.volume(0)


def test_finds_where_a_needle_enters(before):
    found = detect_insertion(SCENE.volume(2, needle(5e-3)), before, PARAMETERS)
    assert isinstance(found, InsertionDetection)
    assert np.linalg.norm(found.p_WEntry - ENTRY) < 4e-3
    on_needle = (found.p_WMedian - ENTRY) @ INWARD
    assert 0 < on_needle < 5e-3
    assert np.linalg.norm(found.p_WMedian - ENTRY - on_needle * INWARD) < 1.5e-3


def test_no_false_start_on_static_tissue(before):
    for number in range(1, 5):
        volume = SCENE.volume(number)
        assert not detect_insertion(volume, before, PARAMETERS)


def test_a_change_all_over_is_not_an_insertion():
    found = detect_insertion(
        Scene(seed=2, spacing=1e-3).volume(2),
        Scene(seed=1, spacing=1e-3).volume(0),
        PARAMETERS,
    )
    assert not found
    assert "spread" in found.reason


def test_tissue_that_comes_and_goes_is_told_from_a_needle():
    scene = Scene(seed=3, spacing=1e-3)

    def breathing(time, shift, shafts=lambda time: None):
        """Tissue shifted in depth by some mm, and a needle that is not, as bright as speckle."""
        tissue, needle = scene.volume(time), scene.volume(time, shafts)
        shifted = np.roll(tissue.intensities, shift, axis=1)
        shaft = needle.intensities > tissue.intensities
        level = np.quantile(tissue.intensities, 0.999)
        bright = np.minimum(needle.intensities, level).astype(np.uint8)
        return dataclasses.replace(needle, intensities=np.where(shaft, bright, shifted))

    previous = breathing(3, 0)
    earlier = [breathing(0, 3), breathing(1, 0), breathing(2, -3)]
    with_needle = breathing(5, 3, needle(8e-3))
    alone = detect_insertion(with_needle, previous, PARAMETERS)
    assert "spread" in alone.reason
    assert "spread" in detect_insertion(with_needle, previous, PARAMETERS, earlier[:1]).reason
    assert not detect_insertion(breathing(5, 3), previous, PARAMETERS, earlier)
    found = detect_insertion(with_needle, previous, PARAMETERS, earlier)
    along = (found.p_WMedian - ENTRY) @ INWARD
    assert 0 < along < 8e-3
    assert np.linalg.norm(found.p_WMedian - ENTRY - along * INWARD) < 2.5e-3


def test_a_change_deep_inside_is_not_an_insertion(before):
    deep = np.array([0, 0.05, 0])
    volume = SCENE.volume(2, lambda time: (deep, deep + 3e-3 * INWARD))
    found = detect_insertion(volume, before, PARAMETERS)
    assert not found
    assert "inside" in found.reason


def test_a_fast_needle_leaves_a_stretched_change(before):
    dim = lambda v: dataclasses.replace(v, intensities=np.minimum(v.intensities, 120))  # noqa: E731
    volume, before = dim(SCENE.volume(2, needle(35e-3))), dim(before)
    found = detect_insertion(volume, before, PARAMETERS)
    assert isinstance(found, InsertionDetection)
    assert found.std > PARAMETERS.max_std
    along = (found.p_WTip - ENTRY) @ INWARD
    assert 20e-3 < along < 36e-3
    published = dataclasses.replace(PARAMETERS, max_stretched_std=0.0)
    assert "spread" in detect_insertion(volume, before, published).reason


def test_tissue_that_moves_along_with_the_probe(before):
    volume = SCENE.volume(2, needle(5e-3), X_WP=RigidTransform([0, 1e-3, 0]))
    at_rest = SCENE.volume(2, X_WP=RigidTransform([0, 1e-3, 0]))
    # The scene's tissue rests in the probe's frame, and its needle in the world.
    assert detect_insertion(volume, before, PARAMETERS)
    assert not detect_insertion(at_rest, before, PARAMETERS)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_probe_that_moved_across_the_tissue_is_compensated(before, axis):
    voxels = 3
    X_WP = RigidTransform(np.eye(3)[axis] * voxels * before.spacing)
    across = lambda v: dataclasses.replace(  # noqa: E731
        v, intensities=np.roll(v.intensities, -voxels, axis), X_WP=X_WP
    )
    assert not detect_insertion(across(SCENE.volume(2)), before, PARAMETERS)
    found = detect_insertion(across(SCENE.volume(2, needle(8e-3))), before, PARAMETERS)
    assert np.linalg.norm(found.p_WMedian - ENTRY) < 8e-3


def test_a_probe_that_moved_too_far(before):
    volume = SCENE.volume(2, needle(5e-3), X_WP=RigidTransform([0, 11e-3, 0]))
    found = detect_insertion(volume, before, PARAMETERS)
    assert not found
    assert "moved 11.00 mm" in found.reason
    published = dataclasses.replace(PARAMETERS, max_motion=0.0)
    moved = SCENE.volume(2, needle(5e-3), X_WP=RigidTransform([0, 1e-3, 0]))
    assert "moved 1.00 mm" in detect_insertion(moved, before, published).reason


def test_tissue_that_changed_while_the_probe_moved(before):
    other = Scene(seed=2, spacing=1e-3).volume(2, X_WP=RigidTransform([0, 1e-3, 0]))
    assert "changed" in detect_insertion(other, before, PARAMETERS).reason


def test_another_grid(before):
    other = Scene(seed=1, spacing=1.5e-3).volume(2)
    assert "grid" in detect_insertion(other, before, PARAMETERS).reason


@pytest.mark.parametrize("level", [0, 100])
def test_constant_volumes(before, level):
    volume = dataclasses.replace(
        before, intensities=np.full(before.intensities.shape, level, np.uint8)
    )
    assert not detect_insertion(volume, volume, PARAMETERS)


@pytest.mark.parametrize("line", [0, GEOMETRY.lines - 1])
@pytest.mark.parametrize("direction", [0, 1])
def test_side_of_the_sector(line, direction):
    volume = SCENE.volume(direction)
    on_side = GEOMETRY.position(12, line, 150, volume.motion.direction)
    inside = GEOMETRY.position(12, abs(line - 5), 150, volume.motion.direction)
    np.testing.assert_allclose(closest_side(volume, inside), on_side, atol=1e-9)


def test_side_of_a_sector_of_unknown_motion_is_where_its_voxels_end(before):
    volume = dataclasses.replace(before, motion=None)
    on_side = GEOMETRY.position(12, 0, 150, 1)
    inside = GEOMETRY.position(12, 5, 150, 1)
    side = closest_side(volume, inside)
    # Along X, not along the arc: from 5 lines within, that is nearly the same.
    assert np.linalg.norm(side - on_side) < 3e-3
    np.testing.assert_allclose(side[1:], inside[1:])


def test_side_of_a_volume_of_unknown_origin(before):
    filled = np.maximum(before.intensities, 1)
    volume = dataclasses.replace(before, motion=None, intensities=filled)
    p = volume.position(np.array(volume.intensities.shape) / 2)
    p[2] = volume.upper[2] - 1e-3
    np.testing.assert_allclose(closest_side(volume, p), [p[0], p[1], volume.upper[2]])


def test_leaf(before):
    detector = InsertionDetector()
    context = detector.CreateDefaultContext()
    volume = detector.GetInputPort("volume")
    previous = detector.GetInputPort("previous_volume")
    detection = detector.GetOutputPort("detection")
    previous.FixValue(context, Value[object](NotFound("no earlier one")))
    volume.FixValue(context, Value[object](NotFound("no volume")))
    assert detection.Eval(context).reason == "no volume"
    volume.FixValue(context, Value[object](SCENE.volume(2, needle(5e-3))))
    assert detection.Eval(context).reason == "no earlier one"
    previous.FixValue(context, Value[object](before))
    assert detection.Eval(context)
    volume.FixValue(context, Value[object]("scan"))
    with pytest.raises(TypeError, match="'volume'"):
        detection.Eval(context)


def small(time, motion=None):
    zeros = np.zeros((2, 2, 2), np.uint8)
    return Volume(zeros, np.zeros(3), np.full(3, 1e-3), RigidTransform(), time, motion)


@pytest.mark.parametrize(
    ("look_back", "age"), [(0.0, 1), (1.0, 1), (1.5, 2), (3.0, 3), (7.0, None)]
)
def test_memory_is_the_same_before_and_after_its_event(look_back, age):
    memory = VolumeMemory(look_back=look_back, period=1.0)
    context = memory.CreateDefaultContext()
    volumes = [small(float(k)) for k in range(7)]
    for k, volume in enumerate(volumes):
        memory.GetInputPort("volume").FixValue(context, Value[object](volume))
        for _ in range(3):
            previous = memory.GetOutputPort("previous_volume").Eval(context)
            if age is None or k < age:
                assert not previous
            else:
                assert previous is volumes[k - age]
            memory.ExecuteForcedEvents(context)


def test_memory_keeps_some_earlier_volumes():
    memory = VolumeMemory(look_back=1.5, history=4.0, period=0.5)
    context = memory.CreateDefaultContext()
    volumes = [small(0.5 * k) for k in range(40)]
    for volume in volumes:
        memory.GetInputPort("volume").FixValue(context, Value[object](volume))
        for _ in range(2):
            previous = memory.GetOutputPort("previous_volume").Eval(context)
            earlier = memory.GetOutputPort("earlier_volumes").Eval(context)
            ages = [volume.time - each.time for each in earlier]
            assert all(1.5 < age <= 5.5 for age in ages)
            assert previous not in earlier
            memory.ExecuteForcedEvents(context)
    assert 3 <= len(ages) <= 4
    assert np.all(np.diff(ages) <= -1.0)


def test_memory_compares_sweeps_of_one_direction():
    memory = VolumeMemory(look_back=0.0, same_direction=True, period=1.0)
    context = memory.CreateDefaultContext()
    volumes = [SCENE.volume(k) for k in range(4)]
    for volume in volumes:
        memory.GetInputPort("volume").FixValue(context, Value[object](volume))
        memory.ExecuteForcedEvents(context)
    assert memory.GetOutputPort("previous_volume").Eval(context) is volumes[1]
