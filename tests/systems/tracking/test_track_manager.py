"""The leaf that manages a track, with each of the filters."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.systems.signals import (
    LineHypotheses,
    LocalizationExplanation,
    NeedleCurve,
    NeedleEstimate,
    NeedleMeasurement,
    NotFound,
    TrackingMode,
    Volume,
)
from sonoservo.systems.tracking import TrackManager, TrackParameters
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.track_lifecycle import TrackLifecycle

R = np.diag([1, 0.2, 0.3, 0.5, 0.2, 0.4]) * 1e-6


def measurement(tip=0.03, time=0.0, y=0.0, entry=0.0):
    curve = NeedleCurve([[entry, y, 0], [tip, y, 0]])
    return NeedleMeasurement(curve, R, time, 100, 0.8)


def lines(needle=0.99):
    """A line that is a needle with a probability, or only speckle."""
    ends = np.array([[[0, 0, 0], [0.03, 0, 0]]])
    classes = [[needle, 0.0, 0.0, 0.0, 1 - needle]]
    return LineHypotheses(0.0, ends, [needle], classes, [3.0], [5.0], [0.0])


def volume(time, X_WP=None):
    X_WP = X_WP or RigidTransform()
    return Volume(np.zeros((2, 2, 2), np.uint8), np.zeros(3), np.full(3, 1e-3), X_WP, time)


class Bench:
    """The manager with its inputs in hand."""

    def __init__(self, needle_filter=None, **parameters):
        lifecycle = TrackLifecycle(
            order=2,
            parameters=TrackParameters(**parameters),
            needle_filter=needle_filter or ControlPointFilter(),
        )
        self.manager = TrackManager(lifecycle=lifecycle, period=0.1)
        self.context = self.manager.CreateDefaultContext()
        self.fix("lines", NotFound("no lines"))
        self.fix("measurement", NotFound("nothing seen"))

    def fix(self, port, value):
        self.manager.GetInputPort(port).FixValue(self.context, Value[object](value))

    def step(self, time, X_WP=None, **values):
        self.fix("volume", volume(time, X_WP))
        for port in ("lines", "measurement", *values):
            self.fix(port, values.get(port, NotFound(f"no {port}")))
        self.manager.ExecuteForcedEvents(self.context)
        return self.estimate

    def output(self, port):
        return self.manager.GetOutputPort(port).Eval(self.context)

    @property
    def estimate(self) -> NeedleEstimate:
        return self.output("estimate")

    def track(self):
        """Find a needle whose tip is at 30 mm, in the volume at 0.6 s."""
        self.step(0.3, lines=lines(0.5), measurement=measurement(time=0.3))
        return self.step(0.6, lines=lines(), measurement=measurement(time=0.58))


def test_a_line_found_is_measured_and_tracked():
    bench = Bench()
    assert bench.step(0.3, lines=lines(0.5)).mode == TrackingMode.SEARCHING
    assert bench.estimate.reason == "no line is a needle with certainty yet"
    estimate = bench.track()
    assert estimate.mode == TrackingMode.TRACKING
    assert (estimate.time, estimate.volume_time) == (0.58, 0.6)
    assert estimate.probability == pytest.approx(0.99)
    np.testing.assert_allclose(estimate.curve.tip, [0.03, 0, 0], atol=1e-3)
    used = bench.output("last_measurement")
    assert used.time == 0.58
    bench.fix("measurement", measurement(0.05, 9.0))
    assert bench.output("last_measurement") is used
    assert not bench.output("last_detection")


def test_prediction_is_the_same_before_and_after_the_update_it_serves():
    bench = Bench()
    bench.track()
    bench.fix("volume", volume(0.9))
    before = bench.output("prediction")
    assert before.time == 0.9
    np.testing.assert_array_equal(before.entry, bench.estimate.curve.entry)
    bench.step(0.9, measurement=measurement(0.032, 0.88))
    after = bench.output("prediction")
    assert after.time == before.time
    np.testing.assert_array_equal(after.curve.control_points, before.curve.control_points)
    np.testing.assert_array_equal(after.covariance, before.covariance)
    bench.fix("volume", volume(1.2))
    assert bench.output("prediction").time == 1.2
    bench.fix("volume", NotFound("dropped"))
    assert bench.output("prediction").reason == "dropped"


def test_explanation_tells_how_far_the_measurement_lies_from_the_prediction():
    bench = Bench()
    assert bench.output("explanation").reason == "no explanation of a localizer is connected"
    bench.track()
    found = measurement(0.03, 0.9, y=0.02)
    explanation = LocalizationExplanation(0.9, NotFound(""), (), found)
    bench.fix("explanation", explanation)
    assert bench.output("explanation").innovation is None
    estimate = bench.step(0.9, measurement=found)
    explained = bench.output("explanation")
    assert explained.measurement is found
    assert explained.innovation > explained.gate > 4
    assert f"{explained.innovation:.1f} standard deviations" in estimate.reason


def test_in_the_probe_s_frame_velocity_is_that_in_the_image():
    """A probe that keeps up with the needle sees it at rest."""
    velocity = {}
    for probe_frame in (False, True):
        bench = Bench(probe_frame=probe_frame)
        bench.track()
        for k in range(1, 30):
            x, time = 5e-3 * 0.3 * k, 0.6 + 0.3 * k
            seen = measurement(0.03 + x, time, entry=x)
            estimate = bench.step(time, X_WP=RigidTransform([x, 0, 0]), measurement=seen)
        velocity[probe_frame] = estimate.tip_velocity[0]
    assert velocity[False] == pytest.approx(5e-3, abs=1e-4)
    assert velocity[True] == pytest.approx(0, abs=1e-4)


def test_repeated_and_missing_volumes_change_nothing():
    bench = Bench()
    before = bench.track()
    for value in (volume(0.6), volume(0.1), NotFound("dropped")):
        bench.fix("volume", value)
        bench.fix("measurement", measurement(0.05, 0.9))
        bench.manager.ExecuteForcedEvents(bench.context)
        assert bench.estimate.time == before.time
        np.testing.assert_array_equal(bench.estimate.curve.tip, before.curve.tip)


def test_starts_where_it_is_told():
    bench = Bench(AxisTipFilter())
    start = measurement(time=0.3)
    bench.manager.start_at(bench.context, start)
    assert bench.estimate.mode == TrackingMode.TRACKING
    assert bench.estimate.volume_time == 0.3
    np.testing.assert_allclose(bench.estimate.curve.control_points, start.curve.control_points)


def test_a_filter_must_take_the_order():
    with pytest.raises(ValueError, match="order: 3"):
        TrackLifecycle(order=3, parameters=TrackParameters(), needle_filter=AxisTipFilter())
