import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import PortDataType

from sonoservo.systems.display import ConsoleFeed
from sonoservo.systems.signals import (
    GuardState,
    GuardStatus,
    LineHypotheses,
    Needle,
    NeedleCurve,
    NeedleEstimate,
    NotFound,
    TrackingMode,
)

SEARCHING = NeedleEstimate(TrackingMode.SEARCHING, 0.0)


class Shown(list):
    """Takes the place of a console: keeps volumes, and samples apart."""

    def __init__(self):
        super().__init__()
        self.samples = []

    def show_volume(self, volume, estimate, number, lines):
        self.append((volume, estimate, number, lines))

    def add(self, sample):
        self.samples.append(sample)


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def publish(leaf, context=None, **values):
    context = context or leaf.CreateDefaultContext()
    for name, value in values.items():
        port = leaf.GetInputPort(name)
        vector = port.get_data_type() == PortDataType.kVectorValued
        typed = Value(value) if isinstance(value, RigidTransform) else Value[object](value)
        port.FixValue(context, [value] if vector else typed)
    leaf.ForcedPublish(context)


def test_each_volume_of_a_run_is_shown_once_and_counted(make_volume):
    shown = Shown()
    leaf = ConsoleFeed(console=shown, period=0.3)
    publish(leaf, volume=NotFound("no sweep is complete yet"), estimate=SEARCHING)
    assert shown == []
    first, second = make_volume(zeros, time=0.5), make_volume(zeros, time=0.8)
    for volume in (first, first, second):
        publish(leaf, volume=volume, estimate=SEARCHING)
    assert shown == [(first, SEARCHING, 1, None), (second, SEARCHING, 2, None)]
    context = leaf.CreateDefaultContext()
    publish(leaf, context, volume=make_volume(zeros, time=1.1))  # no tracker is needed
    assert shown[2][1:] == (None, 3, None)
    samples = len(shown.samples)
    Simulator(leaf, context).AdvanceTo(0.9)  # a new run
    assert shown[3][2] == 1
    assert len(shown.samples) == samples + 8  # eight a second


def test_a_sample_holds_what_instruments_truth_and_guard_say(make_volume):
    shown = Shown()
    leaf = ConsoleFeed(console=shown, period=0.3)
    curve = NeedleCurve([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]])
    believed = NeedleEstimate(
        TrackingMode.COASTING, 0.0, curve, np.zeros((2, 3)), np.eye(12), 0.0, "no line"
    )
    values = {
        "volume": NotFound("lost"),
        "estimate": believed,
        "X_WP": RigidTransform(),
        "X_WT": RigidTransform([0.0, 0.0, 0.001]),
        "needle": Needle([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]], 6e-4),
        "contact_force": 1.9,
        "force_target": 2.0,
        "hold_reason": "the probe does not press",
        "guard": GuardStatus(GuardState.HOLDING, "the sensor is frozen", 1.0, 1),
    }
    publish(leaf, **values)
    (sample,) = shown.samples
    assert sample.mode == "coasting"
    assert sample.inserted == pytest.approx(50.0)
    assert sample.lines == {}
    assert sample.error == pytest.approx(1.0)
    assert (sample.force, sample.target) == (1.9, 2.0)
    assert (sample.reason, sample.held) == ("no line", "the probe does not press")
    assert sample.stopped == "the sensor is frozen"


def test_a_searching_tracker_tells_of_its_lines(make_volume):
    ends = [[[0, 0, 0], [0.05, 0, 0]], [[0, 0, 0.02], [0, 0.01, 0.02]], [[0, 0, 0], [0, 0, 0.1]]]
    classes = [[0.6, 0.1, 0.1, 0.1, 0.1], [0.1, 0.6, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, 0.1, 0.6]]
    lines = LineHypotheses(
        time=0.5, ends=ends, probabilities=[0.6, 0.1, 0.0], classes=classes,
        looks=np.zeros(3), looked=np.ones(3), numbers=np.arange(3),
    )  # fmt: skip
    shown = Shown()
    feed = ConsoleFeed(console=shown, period=0.3)
    publish(feed, volume=make_volume(zeros, time=0.5), estimate=SEARCHING, lines=lines)
    assert shown[0][3] is lines
    (sample,) = shown.samples
    assert sample.probability == pytest.approx(0.6)
    assert sample.lines == {"needle": 1, "resting": 1}  # the third is but speckle
    publish(feed, volume=make_volume(zeros), estimate=SEARCHING, lines=NotFound("tracked"))
    assert np.isnan(shown.samples[1].probability)
