from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.control import VisualServo, VisualServoParameters
from sonoservo.systems.control.visual_servo import planar_velocity
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

X_WP = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0.5, 0, 0.2])
PAPER = VisualServoParameters(gain=0.8, feed_forward=False, max_speed=1, max_angular_speed_deg=200)


def estimate(
    *, tip_P=(0.01, 0.04, 0.02), direction_P=(1.0, 0.1, 0.2), velocity_P=(0.0, 0.0, 0.0),
    mode=TrackingMode.TRACKING, time=0.0,
):  # fmt: skip
    tip_P, direction_P = np.array(tip_P), np.array(direction_P)
    curve = NeedleCurve(np.array([tip_P - 0.05 * direction_P, tip_P])).transformed(X_WP)
    velocity = np.vstack([np.zeros(3), X_WP.rotation().multiply(velocity_P)])
    return NeedleEstimate(mode, time, curve, velocity, 1e-8 * np.eye(12))


def test_law_is_the_papers():
    velocity = planar_velocity(estimate(), X_WP, 0.0, PAPER)
    x, z, theta = 0.01, 0.02, np.arctan2(0.2, 1.0)
    expected = -0.8 * np.array([-x - z * theta, -z + x * theta, theta])
    np.testing.assert_allclose(velocity, expected, atol=1e-12)


def test_a_held_command_does_not_see_the_probe_move_between_two_volumes():
    elsewhere = RigidTransform(X_WP.rotation(), X_WP.translation() + np.array([0.01, 0, 0]))
    held = replace(PAPER, held=True)
    in_probe = replace(estimate(), X_WP=X_WP)
    command = planar_velocity(in_probe, X_WP, 0.0, held)
    np.testing.assert_array_equal(planar_velocity(in_probe, elsewhere, 0.2, held), command)
    assert np.abs(planar_velocity(in_probe, elsewhere, 0.2, PAPER) - command).max() > 1e-3
    assert np.abs(planar_velocity(estimate(), elsewhere, 0.2, held) - command).max() > 1e-3


def test_feed_forward_carries_the_tip_on_to_now():
    parameters = replace(PAPER, feed_forward=True)
    late = planar_velocity(estimate(velocity_P=(0.005, 0.001, -0.004)), X_WP, 0.2, parameters)
    there = estimate(tip_P=(0.011, 0.0402, 0.0192), velocity_P=(0.005, 0.001, -0.004), time=0.2)
    np.testing.assert_allclose(late, planar_velocity(there, X_WP, 0.2, parameters), atol=1e-12)
    centred = estimate(tip_P=(0, 0.04, 0), direction_P=(1, 0, 0), velocity_P=(0.005, 0.002, -0.004))
    velocity = planar_velocity(centred, X_WP, 0.0, parameters)
    np.testing.assert_allclose(velocity, [0.005, -0.004, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("seen", "time", "parameters"),
    [
        (NeedleEstimate(TrackingMode.SEARCHING, 0.0), 0.0, PAPER),
        (estimate(velocity_P=(0.01, 0, 0)), 0.0, replace(PAPER, gain=0.0, feed_forward=True)),
    ],
)
def test_probe_rests_without_a_fresh_needle(seen, time, parameters):
    np.testing.assert_array_equal(planar_velocity(seen, X_WP, time, parameters), 0)


def test_coasting_goes_on_but_feeds_nothing_forward():
    coasting = estimate(mode=TrackingMode.COASTING, velocity_P=(0.02, 0, 0))
    expected = planar_velocity(estimate(), X_WP, 0.1, PAPER)
    for parameters in (PAPER, replace(PAPER, feed_forward=True)):
        velocity = planar_velocity(coasting, X_WP, 0.1, parameters)
        np.testing.assert_array_equal(velocity, expected)


def test_needle_along_the_beam_is_only_centred():
    velocity = planar_velocity(estimate(direction_P=(0.05, 1, 0.1)), X_WP, 0.0, PAPER)
    np.testing.assert_allclose(velocity, [0.008, 0.016, 0], atol=1e-12)


def test_speeds_are_limited():
    parameters = VisualServoParameters(gain=5.0, max_speed=0.02, max_angular_speed_deg=10)
    velocity = planar_velocity(estimate(tip_P=(0.1, 0.04, 0.1)), X_WP, 0.0, parameters)
    assert np.hypot(*velocity[:2]) == pytest.approx(0.02)
    velocity = planar_velocity(estimate(direction_P=(0.1, 0, 1)), X_WP, 0.0, parameters)
    assert np.rad2deg(abs(velocity[2])) == pytest.approx(10)


@pytest.mark.parametrize(
    ("mode", "age", "std", "reason"),
    [
        (TrackingMode.TRACKING, 0.3, 5e-3, ""),
        (TrackingMode.COASTING, 0.3, 20e-3, "the tip is uncertain by 35 mm"),
        (TrackingMode.TRACKING, 1.6, 1e-3, "the estimate is 1.6 s old"),
        (TrackingMode.TRACKING, -9.0, 1e-3, "the estimate is -9.0 s old"),
        (TrackingMode.LOST, 1.6, 20e-3, ""),
    ],
)
def test_the_leaf_follows_or_says_why_it_holds_and_takes_a_gain(mode, age, std, reason):
    uncertain = replace(estimate(mode=mode), covariance=std**2 * np.eye(12))
    servo = VisualServo(parameters=PAPER)
    context = servo.CreateDefaultContext()
    context.SetTime(age)
    servo.GetInputPort("estimate").FixValue(context, Value[object](uncertain))
    servo.GetInputPort("X_WP").FixValue(context, X_WP)
    velocity = servo.GetOutputPort("planar_velocity")
    once = velocity.Eval(context).copy()
    np.testing.assert_array_equal(once, planar_velocity(uncertain, X_WP, age, PAPER))
    assert once.any() == (reason == "" and mode is TrackingMode.TRACKING)
    assert servo.GetOutputPort("hold_reason").Eval(context) == reason
    for gain in (2.4, 0.0):
        servo.GetInputPort("gain").FixValue(context, [gain])
        np.testing.assert_allclose(velocity.Eval(context), gain / 0.8 * once)
