"""The belief about all lines, in volumes in which a needle is pushed in beside what rests."""

from functools import lru_cache

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.tracking.line_belief import BeliefParameters, LineBelief, follow
from sonoservo.systems.tracking.line_follower import LineFollower

ENTRY = entry_on_side()
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
WIRE = (ENTRY + np.array([0.01, 0.02, 0.0]), ENTRY + np.array([0.045, 0.022, -0.012]))
COUNT, SPEED = 14, 9e-3
PARAMETERS = BeliefParameters(lines=30)


def pushed(time):
    """A needle that comes into view after a second and a half."""
    length = SPEED * (time - 1.5)
    return (ENTRY, ENTRY + length * K) if length > 2e-3 else None


class Tissue(Scene):
    """A scene in which all tissue, and a wire in it, rest in W wherever the probe is."""

    def volume(self, number, needle=None, X_WP=None):
        wire = Scene(self.seed, spacing=self.spacing).volume(number, lambda time: WIRE, X_WP)
        if needle is None or needle(wire.time) is None:
            return wire
        other = Scene(self.seed, spacing=self.spacing).volume(number, needle, X_WP)
        brighter = np.maximum(wire.intensities, other.intensities)
        return type(wire)(brighter, wire.origin, wire.spacing, wire.X_WP, wire.time, wire.motion)


@lru_cache
def volumes(needle, moving):
    """The speckle rests in the probe's frame, so only a probe that turns slowly sees it rest."""
    scene = Tissue(seed=5, spacing=1.2e-3)
    poses = [
        RigidTransform(RollPitchYaw(0, 0.01 * n * moving, 0), [0.8e-3 * n * moving, 0, 0])
        for n in range(COUNT)
    ]
    return [scene.volume(n, pushed if needle else None, pose) for n, pose in enumerate(poses)]


def followed(images):
    belief = LineBelief()
    for each in images:
        belief = follow(belief, each, PARAMETERS)
    return belief


def along(lines, a, b):
    """Flags of the lines that lie along a stretch, in W, to 4 mm and 8 deg."""
    k = (b - a) / np.linalg.norm(b - a)
    away = lines.ends - a
    away = np.linalg.norm(away - (away @ k)[..., np.newaxis] * k, axis=-1).max(axis=1)
    d = lines.ends[:, 1] - lines.ends[:, 0]
    return (away < 4e-3) & (np.abs(d @ k) > np.cos(np.radians(8)) * np.linalg.norm(d, axis=1))


@pytest.mark.parametrize("moving", [False, True])
def test_a_needle_that_is_pushed_in_is_found_and_a_wire_at_rest_is_not(moving):
    lines = followed(volumes(True, moving)).hypotheses
    assert lines
    best = int(lines.probabilities.argmax())
    a, b = pushed(lines.time)
    assert lines.probabilities[best] > 0.95
    assert LINE_CLASSES[int(lines.classes[best].argmax())] == "needle"
    assert along(lines, a, b)[best]
    assert np.linalg.norm(lines.ends[best, 1] - b) < 5e-3
    wire = along(lines, *WIRE)
    assert wire.any()
    assert lines.probabilities[wire].max() < 0.05
    np.testing.assert_allclose(lines.classes.sum(axis=1), 1)


@pytest.mark.parametrize("moving", [False, True])
def test_where_no_needle_comes_none_is_found(moving):
    lines = followed(volumes(False, moving)).hypotheses
    assert lines.probabilities.max() < 0.5
    wire = np.flatnonzero(along(lines, *WIRE))
    assert len(wire)
    kinds = [LINE_CLASSES[n] for n in lines.classes[wire].argmax(axis=1)]
    assert "needle" not in kinds


def test_the_same_volumes_give_the_same_bits():
    first, second = (followed(volumes(True, False)[:8]).hypotheses for _ in range(2))
    for name in ("ends", "probabilities", "classes", "looks", "looked", "numbers"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_what_was_not_read_is_looked_up_later():
    """While a needle is tracked nobody looks; then volumes that were kept tell of other lines."""
    images = volumes(True, False)
    belief = followed(images[:4])
    for each in images[4:-1]:
        belief = belief.unread_after(each)
    assert belief.time == images[-2].time
    assert not belief.hypotheses
    lines = follow(belief, images[-1], PARAMETERS).hypotheses
    assert lines.probabilities.max() > 0.95
    assert along(lines, *pushed(lines.time))[lines.probabilities.argmax()]


def test_before_any_volume_there_are_no_lines():
    assert LineBelief().time == -np.inf
    assert len(LineBelief().lines) == 0


def test_leaf_follows_only_while_nothing_is_tracked():
    leaf = LineFollower(parameters=PARAMETERS, period=1.0)
    context = leaf.CreateDefaultContext()
    fix = lambda port, value: leaf.GetInputPort(port).FixValue(context, Value[object](value))  # noqa: E731
    lines = lambda: leaf.GetOutputPort("lines").Eval(context)  # noqa: E731
    searching = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
    fix("estimate", searching)
    fix("volume", NotFound("no sweep"))
    assert lines().reason == "no sweep"
    for each in volumes(False, False)[:2]:
        fix("volume", each)
        before = lines()
        leaf.ExecuteForcedEvents(context)
        after = lines()
        assert before.time == after.time == each.time
        np.testing.assert_array_equal(before.ends, after.ends)
        np.testing.assert_array_equal(before.probabilities, after.probabilities)
    curve = NeedleCurve([ENTRY, ENTRY + 0.02 * K])
    tracking = NeedleEstimate(
        TrackingMode.TRACKING, 0.0, curve, np.zeros((2, 3)), 1e-6 * np.eye(12), 0.0
    )
    fix("estimate", tracking)
    fix("volume", volumes(False, False)[2])
    assert lines().reason == "a needle is being tracked"
    leaf.ExecuteForcedEvents(context)
    belief = leaf.GetOutputPort("belief").Eval(context)
    assert [each.time for each in belief.unread] == [v.time for v in volumes(False, False)[:3]]
    assert len(belief.lines) == 0


@pytest.mark.parametrize(("field", "value"), [("act", 0.5), ("act", 1.0), ("lines", 0)])
def test_parameters_are_checked(field, value):
    with pytest.raises(ValueError, match=field):
        BeliefParameters(**{field: value})
