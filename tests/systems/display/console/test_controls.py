import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from sonoservo.systems.display import OperatorPanel
from sonoservo.systems.display.console.controls import (
    Controls,
    controller_controls,
    operator_controls,
)

CONTROLS = [
    *operator_controls(azimuth_deg=10.0, dip_deg=5.0),
    *controller_controls(gain=1.6, force=2.0, min_force=0.5),
]


class Panel:
    """A panel, its simulation and its inputs."""

    def __init__(self):
        self.inputs = Controls()
        self.system = OperatorPanel(controls=CONTROLS, inputs=self.inputs)
        self.simulator = Simulator(self.system)
        self.simulator.Initialize()

    def read(self, port):
        context = self.simulator.get_context()
        self.simulator.AdvanceTo(context.get_time() + 1 / 16)
        return self.system.GetOutputPort(port).Eval(context)


@pytest.fixture
def panel():
    return Panel()


def test_targets_are_in_si_units(panel):
    np.testing.assert_allclose(panel.read("needle_target"), [0, 0, np.deg2rad(10), np.deg2rad(5)])
    np.testing.assert_array_equal(panel.read("phantom_target"), np.zeros(4))
    np.testing.assert_array_equal(panel.read("controller_target"), [1.6, 2.0])
    for name, value in (("depth", 30), ("turn", 90.0), ("yaw", -20.0)):
        panel.inputs.move(name, value)
    np.testing.assert_allclose(panel.read("needle_target")[:2], [0.03, np.pi / 2])
    np.testing.assert_allclose(panel.read("phantom_target"), [0, 0, 0, np.deg2rad(-20)])


def test_whatever_is_sent_the_targets_stay_in_range(panel):
    panel.inputs.move("depth", 30.0)
    for value in (math.nan, math.inf, -math.inf, 10**400, "deep", None, [1.0], True):
        panel.inputs.move("depth", value)
        assert panel.read("needle_target")[0] == pytest.approx(0.03)
    for value, depth in ((1e308, 0.1), (-1e308, -0.005)):
        panel.inputs.move("depth", value)
        assert panel.read("needle_target")[0] == pytest.approx(depth)
    panel.inputs.move("no such slider", 1.0)
    panel.inputs.deflect("page", [math.nan, "up", None, True] * 9)
    panel.inputs.deflect("other", "x")
    assert panel.read("needle_target")[0] == pytest.approx(-0.005)


def test_a_stick_moves_the_needle_until_its_page_is_gone(panel):
    panel.inputs.deflect("page", [0.05, -1.0])
    depth = panel.read("needle_target")[0]
    assert 0 < depth <= 2 * 0.02 / 16
    assert panel.read("needle_target")[0] > depth
    assert panel.read("needle_target")[1] == 0  # within the stick's dead zone
    panel.inputs.deflect("page", None)
    depth = panel.read("needle_target")[0]
    assert panel.read("needle_target")[0] == depth


def test_each_run_begins_with_the_sliders_at_their_starts(panel):
    panel.inputs.move("depth", 30.0)
    panel.read("needle_target")
    panel.simulator.get_mutable_context().SetTime(0.0)
    panel.system.SetDefaultContext(panel.simulator.get_mutable_context())
    panel.simulator.Initialize()
    assert panel.inputs.value("depth") == 0.0
    assert panel.read("needle_target")[0] == 0.0


def test_pages_are_told_what_moves_and_presses_count_once():
    told = []
    controls = Controls(lambda: told.append(1))
    controls.offer(CONTROLS)
    controls.offer_buttons("pause", "stop", speed=1.0)
    described = controls.description()
    assert described["speeds"]
    assert described["sliders"][0]["keys"] == ["KeyS", "KeyW"]
    before = len(told)
    controls.move("gain", 0.5)
    for speed in (0.25, 17, "fast"):
        controls.set_speed(speed)
    assert controls.speed == 0.25
    assert len(told) == before + 2
    for button in ("pause", "pause", "launch"):
        controls.press(button)
    assert controls.pressed() == {"pause"}
    assert controls.pressed() == set()
