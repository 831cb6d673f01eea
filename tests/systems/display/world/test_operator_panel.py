import math
import time

import numpy as np
import pytest
from page_clients.meshcat_socket import MeshcatSocket
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import Simulator

from sonoservo.systems.display.world.operator_panel import (
    Control,
    OperatorPanel,
    deflection,
    operator_controls,
    within,
)
from sonoservo.systems.display.world.run_buttons import RunButtons

CONTROLS = operator_controls(azimuth_deg=10.0, dip_deg=5.0, gain=1.6, force=2.0, min_force=0.5)
DEPTH, LAMBDA = "depth (mm) S W", "lambda (1/s)"


class Page:
    """A panel, its simulation and a connection to its Meshcat."""

    def __init__(self):
        self.meshcat = Meshcat(MeshcatParams(host="localhost"))
        self.panel = OperatorPanel(meshcat=self.meshcat, controls=CONTROLS)
        self.simulator = Simulator(self.panel)
        self.simulator.Initialize()
        self.socket = MeshcatSocket(self.meshcat)

    def read(self, port):
        """An output after the panel has read what was sent."""
        time.sleep(0.1)
        context = self.simulator.get_context()
        self.simulator.AdvanceTo(context.get_time() + 1 / 16)
        return self.panel.GetOutputPort(port).Eval(context)


@pytest.fixture
def page():
    return Page()


def test_targets_are_in_si_units(page):
    np.testing.assert_allclose(page.read("needle_target"), [0, 0, np.deg2rad(10), np.deg2rad(5)])
    np.testing.assert_array_equal(page.read("phantom_target"), np.zeros(4))
    np.testing.assert_array_equal(page.read("controller_target"), [1.6, 2.0])
    for name, value in ((DEPTH, 30.0), ("turn (deg) A D", 90.0), ("phantom (deg)", -20.0)):
        page.socket.slide(name, value)
    np.testing.assert_allclose(page.read("needle_target")[:2], [0.03, np.pi / 2])
    np.testing.assert_allclose(page.read("phantom_target"), [0, 0, 0, np.deg2rad(-20)])


def test_whatever_is_sent_the_targets_stay_in_range(page):
    page.socket.slide(DEPTH, 30.0)
    page.read("needle_target")
    for value in (math.nan, math.inf, -math.inf, "deep", None, [1.0]):
        page.socket.slide(DEPTH, value)
        assert page.read("needle_target")[0] == pytest.approx(0.03)
        assert page.meshcat.GetSliderValue(DEPTH) in (30.0, value)
    for value, depth in ((1e308, 0.1), (-1e308, -0.005)):
        page.socket.slide(DEPTH, value)
        assert page.read("needle_target")[0] == pytest.approx(depth)
    page.socket.slide("no such slider", 1.0)
    page.socket.say(type="gamepad", name="", gamepad={"index": 0, "axes": [math.nan] * 9})
    assert page.read("needle_target")[0] == pytest.approx(-0.005)


def test_a_stick_moves_the_needle_until_its_page_is_gone(page):
    pushed = {"index": 0, "button_values": [], "axes": [0.05, -1.0]}
    page.socket.say(type="gamepad", name="", gamepad=pushed)
    depth = page.read("needle_target")[0]
    assert 0 < depth <= 0.02 / 16 + 1e-9
    assert page.read("needle_target")[0] > depth
    assert page.read("needle_target")[1] == 0  # within the stick's dead zone
    page.socket.close()
    depth = page.read("needle_target")[0]
    assert page.read("needle_target")[0] == depth


def test_each_run_begins_with_the_sliders_at_their_starts(page):
    page.socket.slide(DEPTH, 30.0)
    page.read("needle_target")
    page.simulator.get_mutable_context().SetTime(0.0)
    page.panel.SetDefaultContext(page.simulator.get_mutable_context())
    page.simulator.Initialize()
    assert page.meshcat.GetSliderValue(DEPTH) == 0.0
    assert page.read("needle_target")[0] == 0.0


def test_many_clicks_count_once(page):
    buttons = RunButtons(meshcat=page.meshcat, buttons={"pause": ("pause", "Space")})
    for _ in range(10_000):
        page.socket.click("pause")
    page.socket.slide(LAMBDA, 0.3)  # comes after them all
    while page.meshcat.GetSliderValue(LAMBDA) != 0.3:
        time.sleep(0.01)
    assert buttons.pressed() == {"pause"}
    assert buttons.pressed() == set()


def test_values_and_sticks_are_checked():
    control = Control(port="p", label="l", unit=1.0, least=-1, most=2, step=1)
    values = {math.nan: 0.5, math.inf: 0.5, 3.0: 2, -3.0: -1, 1.25: 1.25}
    for value, wanted in values.items():
        assert within(control, value, 0.5) == wanted
    sticks = {0.1: 0, -0.1: 0, 1.0: 1, -1.0: -1, 5.0: 1, math.nan: 0, math.inf: 0}
    for axis, wanted in sticks.items():
        assert deflection(axis) == wanted
    assert deflection(0.575) == pytest.approx(0.5)
