import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from synthetic_volumes import ENTRY, Scene

from sonoservo.diagrams.papers.chatelain2013.method.detection import PublishedDetectionParameters
from sonoservo.diagrams.papers.chatelain2013.method.insertion_detector import InsertionDetector
from sonoservo.systems.signals import NotFound, Volume
from sonoservo.systems.tracking import VolumeMemory

INWARD = np.array([1, 0.2, 0.1]) / np.linalg.norm([1, 0.2, 0.1])
SCENE = Scene(seed=1, spacing=1.0e-3, balls=[([0.01, 0.06, 0.005], 2e-3)])


def needle(length):
    return lambda time: (ENTRY, ENTRY + length * INWARD)


@pytest.fixture(scope="module")
def before():
    return SCENE.volume(0)


def test_leaf(before):
    detector = InsertionDetector(parameters=PublishedDetectionParameters(candidate_volume=5e-9))
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


def test_memory_is_the_same_before_and_after_its_event():
    memory = VolumeMemory(period=1.0)
    context = memory.CreateDefaultContext()
    volumes = [small(float(k)) for k in range(7)]
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
