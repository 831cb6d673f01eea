import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.diagrams import (
    MakeProbeController,
    MakeStation,
    ProbeControllerParameters,
    ProbePlacement,
    StationParameters,
)
from sonoservo.systems.control import VisualServoParameters, needle_features
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

VOLUME_PERIOD = 0.303


class PerfectTracker(LeafSystem):
    """Estimates without error, but only as often, and as late, as volumes come."""

    def __init__(self, *, tip, direction, velocity=(0, 0, 0), start=2.0):
        super().__init__()
        self._tip, self._direction, self._start = np.array(tip), np.array(direction), start
        self._velocity = np.array(velocity)
        self.DeclareAbstractOutputPort(
            "estimate",
            lambda: Value[object](),
            self._calc_estimate,
            prerequisites_of_calc={self.time_ticket()},
        )

    def tip(self, time):
        return self._tip + max(time - self._start, 0) * self._velocity

    def _calc_estimate(self, context, output):
        time = context.get_time() // VOLUME_PERIOD * VOLUME_PERIOD - VOLUME_PERIOD / 2
        if time < self._start:
            output.set_value(NeedleEstimate(TrackingMode.SEARCHING, time))
            return
        tip = self.tip(time)
        curve = NeedleCurve(np.array([tip - 0.05 * self._direction, tip]))
        velocity = np.vstack([np.zeros(3), self._velocity])
        covariance = 1e-8 * np.eye(12)
        output.set_value(NeedleEstimate(TrackingMode.TRACKING, time, curve, velocity, covariance))


class Loop:
    """Station, controller and a perfect tracker."""

    def __init__(self, *, tracker, station=None, controller=None, lifts=None, probe="4dc7_3_40"):
        station = station or StationParameters(probe=ProbePlacement(height=0.008))
        builder = DiagramBuilder()
        self.station = builder.AddSystem(MakeStation(parameters=station, probe=probe))
        self.controller = builder.AddSystem(
            MakeProbeController(
                parameters=controller or ProbeControllerParameters(), arm=station.arm, probe=probe
            )
        )
        self.tracker = builder.AddSystem(tracker)
        lifts = lifts or {0.0: 0.0, 1.0: 0.0}
        rest = np.concatenate([station.X_WT.translation(), np.zeros(3)])
        poses = [rest + np.array([0, 0, lift, 0, 0, 0]) for lift in lifts.values()]
        path = PiecewisePolynomial.CubicShapePreserving(
            list(lifts), np.array(poses).T, zero_end_point_derivatives=True
        )
        motion = builder.AddSystem(PhantomMotion(trajectory=path))
        wires = [
            (self.tracker, "estimate", self.controller, "estimate"),
            (self.controller, "joint_command", self.station, "joint_command"),
            *(
                (self.station, port, self.controller, port)
                for port in ("X_WP", "wrist_force", "joint_state", "external_torque")
            ),
        ]
        for source, output, sink, port in wires:
            builder.Connect(source.GetOutputPort(output), sink.GetInputPort(port))
        builder.Connect(motion.get_output_port(), self.station.GetInputPort("phantom_command"))
        self._force = LogVectorOutput(self.station.GetOutputPort("contact_force"), builder, 0.005)
        self.simulator = Simulator(builder.Build())

    def run(self, until):
        self.simulator.AdvanceTo(until)
        return self

    def force(self):
        """Times in s and true contact forces in N."""
        log = self._force.FindLog(self.simulator.get_context())
        return log.sample_times(), log.data()[0]

    def probe_pose(self):
        context = self.station.GetMyContextFromRoot(self.simulator.get_context())
        return self.station.GetOutputPort("X_WP").Eval(context)

    def features(self):
        """True features in m, m, rad."""
        X_PW = self.probe_pose().inverse()
        tip = self.tracker.tip(self.simulator.get_context().get_time())
        direction = X_PW.rotation().multiply(self.tracker._direction)
        return needle_features(X_PW.multiply(tip), direction)


def still_needle(angle_deg=40.0):
    angle = np.deg2rad(angle_deg)
    return PerfectTracker(tip=[0.52, 0.01, 0.155], direction=[np.cos(angle), np.sin(angle), 0])


def no_needle():
    return PerfectTracker(tip=np.zeros(3), direction=[1, 0, 0], start=np.inf)


def test_probe_lands_gently_and_holds_two_newtons():
    station = StationParameters(
        plant=MultibodyPlantConfig(time_step=0.005), probe=ProbePlacement(height=0.008)
    )
    loop = Loop(tracker=no_needle(), station=station).run(2.0)
    before = loop.probe_pose()
    times, force = loop.run(3.0).force()
    landed = times[np.argmax(force > 0)]
    assert 0.5 < landed < 1.2
    assert force.max() < 2.5
    np.testing.assert_allclose(force[times > landed + 1.0], 2.0, atol=0.1)
    assert force[times > 2.5].mean() == pytest.approx(2.0, abs=0.02)
    moved = before.inverse() @ loop.probe_pose()  # without a needle, nowhere
    assert np.linalg.norm(moved.translation()) < 5e-5
    np.testing.assert_allclose(moved.rotation().matrix(), np.eye(3), atol=1e-4)


def test_contact_lost_is_regained():
    lifts = {0.0: 0.0, 2.5: 0.0, 2.7: -0.01, 6.0: -0.01}
    times, force = Loop(tracker=no_needle(), lifts=lifts).run(5.0).force()
    assert (force[(times > 2.5) & (times < 3.5)] == 0).any()
    assert force.max() < 3.0
    np.testing.assert_allclose(force[times > 4.2], 2.0, atol=0.1)


def test_breathing_is_followed():
    """+-5 mm at 0.25 Hz."""
    knots = np.arange(2.5, 8, 0.1)
    breath = {0.0: 0.0, **{t: 0.005 * (np.cos(np.pi / 2 * (t - 2.5)) - 1) for t in knots}}
    times, force = Loop(tracker=no_needle(), lifts=breath).run(7.5).force()
    np.testing.assert_allclose(force[times > 4], 2.0, atol=0.15)


def test_needle_40_degrees_off_is_centred_and_aligned():
    loop = Loop(tracker=still_needle()).run(2.0)
    x, z, theta = loop.features()
    assert np.rad2deg(theta) == pytest.approx(40, abs=0.1)
    loop.run(11.0)
    x, z, theta = loop.features()
    assert np.abs([x, z]).max() < 0.1e-3
    assert np.rad2deg(abs(theta)) < 0.2
    # The two controls are decoupled, and the axis stays vertical.
    times, force = loop.force()
    np.testing.assert_allclose(force[times > 2.0], 2.0, atol=0.1)
    assert -loop.probe_pose().rotation().matrix()[2, 1] > 1 - 1e-6


@pytest.mark.parametrize(
    ("arm", "probe"),
    [pytest.param("lbr_iiwa_14", "zhao2012", marks=pytest.mark.slow), ("viper_s850", "trus")],
)
def test_other_arms_and_probes_press_and_turn_to_the_needle_too(arm, probe):
    station = StationParameters(arm=arm, probe=ProbePlacement(height=0.008))
    loop = Loop(tracker=still_needle(), station=station, probe=probe).run(7.0)
    x, z, theta = loop.features()
    assert np.abs([x, z]).max() < 1e-3
    assert np.rad2deg(abs(theta)) < 2
    times, force = loop.force()
    assert force.max() < 3.0
    np.testing.assert_allclose(force[times > 3.0], 2.0, atol=0.1)
    assert -loop.probe_pose().rotation().matrix()[2, 1] > 1 - 1e-5


@pytest.mark.parametrize("feed_forward", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_moving_needle_lags_only_without_feed_forward(feed_forward):
    tracker = PerfectTracker(tip=[0.48, 0, 0.155], direction=[1, 0, 0], velocity=[0.005, 0, 0])
    servo = VisualServoParameters(gain=0.83, feed_forward=feed_forward)
    controller = ProbeControllerParameters(visual_servo=servo)
    loop = Loop(tracker=tracker, controller=controller).run(10.0)
    # v / lambda, and what the tip moves in the age of an estimate.
    x, z, theta = loop.features()
    if feed_forward:
        assert abs(x) < 0.2e-3
    else:
        lag = 0.005 / 0.83
        assert lag < x < lag + 0.005 * 1.5 * VOLUME_PERIOD
    assert abs(z) < 0.1e-3
    assert abs(theta) < 1e-3


def test_force_holds_while_the_probe_is_dragged_at_20_mm_per_s():
    tracker = PerfectTracker(tip=[0.45, 0, 0.155], direction=[1, 0, 0], velocity=[0.02, 0, 0])
    station = StationParameters(probe=ProbePlacement(x=-0.05, height=0.008))
    loop = Loop(tracker=tracker, station=station).run(2.5)
    before = loop.probe_pose().translation()[0]
    loop.run(6.0)
    assert loop.probe_pose().translation()[0] - before > 0.06
    times, force = loop.force()
    np.testing.assert_allclose(force[times > 2.2], 2.0, atol=0.1)


def test_the_wanted_force_may_be_changed_on_the_way():
    loop = Loop(tracker=no_needle()).run(4.0)
    context = loop.controller.GetMyMutableContextFromRoot(loop.simulator.get_mutable_context())
    target = loop.controller.GetInputPort("force_target")
    for start, force in ((4.0, 5.0), (7.0, 1.0)):
        before = loop.force()[1][-1]
        target.FixValue(context, [force])
        times, forces = loop.run(start + 3).force()
        settled = forces[times > start + 2]
        np.testing.assert_allclose(settled, force, atol=0.1)
        beyond = np.sign(force - before) * (forces[times > start] - force)
        assert beyond.max() < 0.6  # of steps of 2 to 4 N: no windup
