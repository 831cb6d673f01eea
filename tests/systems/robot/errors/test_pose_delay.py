import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from sonoservo.systems.robot import PoseDelay, PoseDelayParameters

STEP = 1 / 256
RATE = 0.1


class Stepped(LeafSystem):
    """A pose that moves at `RATE` along x, in steps, as a discrete plant's does."""

    def __init__(self):
        super().__init__()
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(STEP, 0.0, self._update)
        self.DeclareAbstractOutputPort(
            "pose",
            lambda: Value(RigidTransform()),
            self._calc,
            prerequisites_of_calc={self.xd_ticket()},
        )

    def _update(self, context, state):
        state.set_value(context.get_discrete_state_vector().value() + RATE * STEP)

    def _calc(self, context, output):
        x = context.get_discrete_state_vector()[0]
        output.set_value(RigidTransform([x, 0, 0]))


def ages(times, *, seed=0, **parameters):
    """Age of the pose in s at times, from how far it lags."""
    builder = DiagramBuilder()
    source = builder.AddSystem(Stepped())
    delay = PoseDelay(parameters=PoseDelayParameters(**parameters), period=STEP, seed=seed)
    builder.AddSystem(delay)
    builder.Connect(source.get_output_port(), delay.get_input_port())
    simulator = Simulator(builder.Build())
    found = []
    for time in times:
        simulator.AdvanceTo(time)
        root = simulator.get_context()
        true, read = (
            each.get_output_port().Eval(each.GetMyContextFromRoot(root)).translation()[0]
            for each in (source, delay)
        )
        found.append((true - read) / RATE)
    return np.array(found)


@pytest.mark.parametrize("steps", [0, 13])
def test_pose_is_exactly_that_of_a_time_ago(steps):
    between, at = STEP * (np.arange(20, 60) + 0.4), STEP * np.arange(20, 60)
    for times in (between, at):
        np.testing.assert_allclose(ages(times, delay=steps * STEP), steps * STEP, atol=1e-12)


def test_before_the_start_the_probe_rests():
    np.testing.assert_allclose(ages(STEP * np.arange(1, 9), delay=1.0), STEP * np.arange(1, 9))


def test_ages_have_their_mean_and_their_deviation_and_are_repeatable():
    times = STEP * np.arange(200, 1000)
    found = ages(times, delay=0.1, jitter=0.02)
    # Ages are whole steps, because the pose is.
    assert found.mean() == pytest.approx(0.1, abs=4 * 0.02 / np.sqrt(len(times)) + STEP / 2)
    assert found.std() == pytest.approx(0.02, rel=0.1)
    np.testing.assert_array_equal(ages(times, delay=0.1, jitter=0.02), found)
    assert (ages(times[:20], delay=0.1, jitter=0.02, seed=1) != found[:20]).any()
    assert (ages(times, jitter=0.02) >= 0).all()
