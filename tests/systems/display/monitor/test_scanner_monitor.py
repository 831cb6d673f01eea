import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from sonoservo.systems.display.monitor.scanner_monitor import ScannerMonitor
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

SEARCHING = NeedleEstimate(TrackingMode.SEARCHING, 0.0)


class Shown(list):
    """Takes the place of a monitor."""

    def show(self, volume, estimate, number):
        self.append((volume, estimate, number))


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def publish(leaf, **values):
    context = leaf.CreateDefaultContext()
    for name, value in values.items():
        leaf.GetInputPort(name).FixValue(context, Value[object](value))
    leaf.ForcedPublish(context)


def test_each_volume_is_shown_once_and_counted(make_volume):
    shown = Shown()
    leaf = ScannerMonitor(monitor=shown, period=0.3)
    publish(leaf, volume=NotFound("no sweep is complete yet"), estimate=SEARCHING)
    assert shown == []
    first, second = make_volume(zeros, time=0.5), make_volume(zeros, time=0.8)
    for volume in (first, first, second):
        publish(leaf, volume=volume, estimate=SEARCHING)
    assert shown == [(first, SEARCHING, 1), (second, SEARCHING, 2)]


def test_no_tracker_is_needed(make_volume):
    shown = Shown()
    volume = make_volume(zeros)
    publish(ScannerMonitor(monitor=shown, period=0.3), volume=volume)
    assert shown == [(volume, None, 1)]


def test_a_wrong_value_is_refused(make_volume):
    leaf = ScannerMonitor(monitor=Shown(), period=0.3)
    with pytest.raises(
        TypeError, match="port 'volume' .* received a value of type str; expected Volume"
    ):
        publish(leaf, volume="volume")
    with pytest.raises(ValueError, match="period: 0 is not allowed"):
        ScannerMonitor(monitor=Shown(), period=0)


class Scanner(LeafSystem):
    """A new volume every 0.25 s."""

    def __init__(self, make_volume):
        super().__init__()
        self._make = make_volume
        self.DeclareStateOutputPort(
            "volume", self.DeclareAbstractState(Value[object](NotFound("none")))
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.25, 0.25, self._update)

    def _update(self, context, state):
        volume = self._make(zeros, time=context.get_time())
        state.get_mutable_abstract_state(0).set_value(volume)


def test_in_a_diagram_every_volume_of_each_run_is_shown(make_volume):
    shown = Shown()
    builder = DiagramBuilder()
    source = builder.AddSystem(Scanner(make_volume))
    leaf = builder.AddSystem(ScannerMonitor(monitor=shown, period=0.25, offset=0.26))
    builder.Connect(source.GetOutputPort("volume"), leaf.GetInputPort("volume"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.3)
    assert [volume.time for volume, _, _ in shown] == [0.25, 0.5, 0.75, 1.0, 1.25]
    simulator.reset_context(simulator.get_system().CreateDefaultContext())
    simulator.AdvanceTo(0.6)
    assert [number for _, _, number in shown] == [1, 2, 3, 4, 5, 1, 2]
