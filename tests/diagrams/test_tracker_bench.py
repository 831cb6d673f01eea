"""One loop from any source of volumes through a tracker to any sinks."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem

from sonoservo.diagrams import MakeTrackerBench, TrackerBench
from sonoservo.diagrams.tracker_bench import OBSERVED, Sample
from sonoservo.diagrams.wiring import TRUTH
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals import Needle, NeedleCurve, NeedleEstimate, TrackingMode, Volume

NEEDLE = np.array([[-0.02, 0.03, 0], [0.01, 0.04, 0.01]])


class Sure(LeafSystem):
    """A tracker with the least that it needs, which sees the same needle in every volume."""

    def __init__(self):
        super().__init__()
        self.DeclareAbstractInputPort("volume", Value[object]())
        nothing = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
        index = self.DeclareAbstractState(Value[object](nothing))
        self.DeclareStateOutputPort("estimate", index)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _update(self, context, state):
        time = self.GetInputPort("volume").Eval(context).time
        estimate = NeedleEstimate(
            TrackingMode.TRACKING, time, NeedleCurve(NEEDLE), np.zeros((2, 3)), 1e-6 * np.eye(12),
            time,
        )  # fmt: skip
        state.get_mutable_abstract_state(0).set_value(estimate)


def samples(count):
    truth = {"needle": Needle(NEEDLE, 1e-3), "X_WT": RigidTransform(), "contact_force": [2.0]}
    for number in range(count):
        grey = np.full((4, 5, 6), 40 + number, np.uint8)
        volume = Volume(grey, np.zeros(3), np.full(3, 1e-3), RigidTransform(), 0.5 * (number + 1))
        yield Sample(volume, observed=truth, read_s=0.25)


def test_every_sink_receives_every_volume_and_the_log_the_truth():
    bench, first, second = TrackerBench(Sure()), [], []
    assert bench.run(samples(3), [first.append, second.append])
    assert [each.number for each in first] == [0, 1, 2]
    assert first == second
    assert [each.estimate.time for each in first] == [each.volume.time for each in first]
    log = bench.log()
    np.testing.assert_array_equal(log.volume_time, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(log.needle_tip, 3 * [NEEDLE[-1]])
    np.testing.assert_array_equal(log.contact_force, 2.0)
    np.testing.assert_array_equal(log.compute["read"], 0.25)
    assert len(log.compute["track"]) == 3


def test_the_truth_goes_to_the_log_alone():
    tracker = Sure()
    bench = MakeTrackerBench(tracker=tracker)
    assert set(OBSERVED) & TRUTH
    ports = [bench.get_input_port(k).get_name() for k in range(bench.num_input_ports())]
    assert ports == ["volume", *OBSERVED]
    assert tracker.num_input_ports() == 1
    with pytest.raises(ConfigurationError, match="no output 'explanation'"):
        TrackerBench(Sure(), explain="folder")
