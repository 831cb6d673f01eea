"""What errors of the instruments do to a run, each against its closed form."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from sonoservo.diagrams import (
    assemble_arm,
    draw_seeds,
    load_scenario,
    make_experiment,
    run,
    tracker_events,
)
from sonoservo.systems.robot.errors.calibration import hand_eye_error, joint_offsets
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode, Volume

FAST = [
    "station.plant.contact_model=point",
    "station.probe.height=0.002",
    "imaging.sector=0.1",
    "imaging.depth=0.05",
    "imaging.frames=9",
    "hand.entry=[-0.12, 0.0, -0.02]",
]
P_TIP = np.array([0.012, 0.03, 0.008])
"""Place in P at which the tracker below sees a tip."""


def scenario(*changes, duration=2.5):
    return load_scenario(
        "chatelain2013_fig5", seed=104, changes=[f"duration={duration}", *FAST, *changes]
    )


class SameInProbe(LeafSystem):
    """Tracker that sees a tip at one place of every volume, at the time of its middle frame."""

    def __init__(self, *, period, offset, mode=TrackingMode.TRACKING):
        super().__init__()
        self._mode = mode
        self.DeclareAbstractInputPort("volume", Value[object]())
        start = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
        self.DeclareStateOutputPort("estimate", self.DeclareAbstractState(Value[object](start)))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)

    def _update(self, context, state):
        volume = self.GetInputPort("volume").Eval(context)
        if isinstance(volume, Volume):
            points = np.array([P_TIP - [0.03, 0.0, 0.01], P_TIP])
            curve = NeedleCurve(points).transformed(volume.X_WP)
            estimate = NeedleEstimate(
                self._mode, volume.time, curve, np.zeros((2, 3)), 1e-6 * np.eye(12), volume.time
            )
            state.get_mutable_abstract_state(0).set_value(estimate)


def moving_run(*changes, duration=2.5):
    """Log of a run in which the probe moves after a tip that moves with it."""
    plan = scenario(*changes, duration=duration)
    return run(plan, tracker=SameInProbe(**tracker_events(plan))).log


def places(X, p=(0.0, 0.0, 0.0)):
    return X[:, :3, :3] @ np.array(p) + X[:, :3, 3]


def test_delay_measured_by_cross_correlation_is_the_dials():
    # Samples at multiples of 1/32 s; a delay of two of them, and steps of 1/128 s.
    changes = ["station.pose_delay.delay=0.0625", "station.plant.time_step=0.0078125"]
    log = moving_run(*changes, "controller.visual_servo.gain=3")
    true, measured = np.diff(log.X_WP[:, 0, 3]), np.diff(log.measured_X_WP[:, 0, 3])
    match = [np.corrcoef(true[8 - lag : -lag or None], measured[8:])[0, 1] for lag in range(8)]
    assert np.argmax(match) / 32 == 0.0625
    assert match[2] == pytest.approx(1)
    np.testing.assert_array_equal(log.measured_X_WP[2:], log.X_WP[:-2])
    # A volume's pose is late by as much, and so is the place that it gives to a tip.
    speed = np.linalg.norm(np.gradient(places(log.X_WP), log.time, axis=0), axis=1)
    miss = np.linalg.norm(places(log.volume_X_WP) - places(log.volume_true_X_WP), axis=1)
    expected = 0.0625 * np.interp(log.volume_true_time - 0.03, log.time, speed)
    assert expected.max() > 0.5e-3
    np.testing.assert_allclose(miss, expected, atol=0.15e-3)


def test_hand_eye_error_shifts_the_tip_by_what_the_transform_says(tmp_path):
    changes = [
        "station.calibration.hand_eye_translation=0.002",
        "station.calibration.hand_eye_rotation_deg=1",
        "controller.kinematics.axis_gain=6",
    ]
    plan = scenario(*changes)
    X_PC = hand_eye_error(plan.station.calibration, draw_seeds(plan).station)
    events = tracker_events(plan)
    log = run(plan, tracker=SameInProbe(**events), out=tmp_path).log
    page = (tmp_path / "report.html").read_text()
    assert f"The tracker is {__name__}.SameInProbe" in page
    assert "chatelain2013;" not in page
    assert "To repeat it" not in page
    seen = events["offset"] + events["period"] * np.arange(len(log.volume_time))
    assert seen[-1] < 2.5 < seen[-1] + events["period"]
    np.testing.assert_allclose(log.volume_seen, seen, atol=1e-5)
    true = places(log.volume_true_X_WP, P_TIP)
    shift = X_PC.multiply(P_TIP) - P_TIP
    expected = log.volume_true_X_WP[:, :3, :3] @ shift
    assert np.linalg.norm(shift) > 1e-3
    np.testing.assert_allclose(log.volume_estimate_tip - true, expected, atol=1e-9)
    # The axis that is kept vertical is the calibrated one, to which the true one has the angle.
    down = -log.measured_X_WP[-1, 2, 1], -log.X_WP[-1, 2, 1]
    assert down[0] > 1 - 1e-6
    assert down[1] == pytest.approx(X_PC.rotation().matrix()[1, 1], abs=5e-6)


def test_measured_pose_is_that_of_joints_with_offsets():
    plan = scenario("station.calibration.joint_offset_deg=0.2", duration=0.5)
    experiment = make_experiment(plan)
    experiment.run()
    log = experiment.log()
    offsets = joint_offsets(plan.station.calibration, 6, draw_seeds(plan).station)
    arm = assemble_arm()
    context = arm.plant.CreateDefaultContext()
    for shift, X in ((0.0, log.measured_X_WP[-1]), (offsets, log.X_WP[-1])):
        arm.plant.SetPositions(context, log.joint_state[-1, :6] - shift)
        np.testing.assert_allclose(arm.frame.CalcPoseInWorld(context).GetAsMatrix4(), X, atol=1e-9)
    # The servo holds the joints where they were, though both of its ends are wrong.
    assert np.linalg.norm(places(log.X_WP)[-1] - places(log.X_WP)[0]) < 0.01
    assert np.linalg.norm(places(log.measured_X_WP - log.X_WP)[0]) > 0.5e-3


WEIGHT = 0.5 * 9.81


@pytest.mark.parametrize(
    ("change", "shift"),
    [
        ("station.wrist_sensor.force_bias=0.3", 0.3),
        ("station.calibration.probe_mass=0.05", 0.05 * WEIGHT),
    ],
)
def test_held_force_is_wrong_by_exactly_the_error(change, shift):
    log = moving_run(change, "controller.visual_servo.gain=0")
    last = log.time > 2
    assert log.contact_force[last].mean() == pytest.approx(2.0 - shift, abs=0.02)


def test_tracker_that_needs_longer_than_a_sweep_gets_every_other_one_or_so():
    plan = scenario("processing_time=0.5", duration=4.0)
    seen = []
    experiment = make_experiment(plan, tracker=SameInProbe(**tracker_events(plan)))
    experiment.run(lambda each: seen.append(each.time))
    log = experiment.log()
    period, frame = 1 / 3.3, 1 / 3.3 / 9
    busy = np.ceil(0.5 / frame) * frame
    done = period + busy * np.arange(1, len(log.volume_time) + 1)
    np.testing.assert_allclose(log.volume_seen, done, atol=1e-4)
    np.testing.assert_allclose(seen, log.volume_seen, atol=1e-4)
    newest = np.floor((done - busy) / period + 1e-6) - 1
    np.testing.assert_allclose(log.volume_time, (newest + 4 / 9) * period, atol=1e-6)
    assert len(experiment.compute["track"]) == len(log.volume_time) == 7
