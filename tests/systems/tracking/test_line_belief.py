"""The belief about all lines, in volumes in which a needle is pushed in beside what rests."""

from dataclasses import replace
from functools import lru_cache, reduce

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter
from synthetic_volumes import line

from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, NotFound, TrackingMode, Volume
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.tracking import LineFollower
from sonoservo.systems.tracking.line_belief import (
    LineBelief,
    _new_lines,
    _of_structures,
    explain_lines,
    follow,
)

START = np.array([-0.025, 0.03, 0.02])
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
WIRE = np.array([[0.0, 0.05, 0.045], [0.055, 0.053, 0.03]])
COUNT, PERIOD, SPEED = 18, 0.3, 9e-3
SPACING, SHAPE = 1.2e-3, (56, 50, 50)


def pushed(time):
    """A needle that comes into view after about a second, in W."""
    return START, START + (0.02 + SPEED * time) * K


@lru_cache
def volumes(needle, moving, slower=1, ahead=0.0, fresh=False):
    """Speckle and a wire that rest in W, and a needle; the probe rests, or moves against X.

    The needle may be pushed slower by a factor, in as many more volumes, and something of an
    amplitude may rest ahead of it on its own line. Fresh speckle is drawn anew for each volume.
    """
    rng = np.random.default_rng(5)
    sigma = np.array([1.9e-3, 0.45e-3, 2.3e-3]) / 2.355 / SPACING
    shape = (SHAPE[0] + COUNT, *SHAPE[1:])
    p_W = SPACING * np.moveaxis(np.indices(shape), 0, -1)

    def speckle():
        parts = [gaussian_filter(rng.normal(size=shape), sigma) for _ in range(2)]
        return (parts[0] + 1j * parts[1]) / np.hypot(parts[0].std(), parts[1].std())

    tissue, wire = speckle(), line(p_W, *WIRE, lambda s: 8.0)
    wire = wire + line(p_W, START + 0.076 * K, START + 0.09 * K, lambda s: ahead)
    images = []
    for n in range(COUNT * slower):
        tissue = speckle() if fresh else tissue
        amplitude = tissue + wire + 0.02 * rng.normal(size=shape)
        if needle:
            amplitude = amplitude + line(p_W, *pushed(PERIOD * n / slower), lambda s: 8.0)
        grey = np.clip((20 * np.log10(np.abs(amplitude) + 1e-6) + 14) * 255 / 60, 1, 255)
        first = (COUNT - 1 - n) * moving
        images.append(
            Volume(
                grey[first : first + SHAPE[0]].astype(np.uint8), np.zeros(3), np.full(3, SPACING),
                RigidTransform([SPACING * first, 0, 0]), PERIOD * n, decibels_per_level=60 / 255,
            )
        )  # fmt: skip
    return images


def followed(images):
    return reduce(follow, images, LineBelief())


@pytest.fixture(scope="module")
def pushed_in():
    return followed(volumes(True, True))


def along(lines, a, b):
    """Flags of the lines that lie along a stretch, in W, to 4 mm and 8 deg."""
    k = (b - a) / np.linalg.norm(b - a)
    away = lines.ends - a
    away = np.linalg.norm(away - (away @ k)[..., np.newaxis] * k, axis=-1).max(axis=1)
    d = lines.ends[:, 1] - lines.ends[:, 0]
    return (away < 4e-3) & (np.abs(d @ k) > np.cos(np.radians(8)) * np.linalg.norm(d, axis=1))


def test_a_needle_that_is_pushed_in_is_found_and_a_wire_at_rest_is_not(pushed_in):
    lines = pushed_in.hypotheses
    best = int(lines.probabilities.argmax())
    a, b = pushed(lines.time)
    assert lines.probabilities[best] > 0.95
    assert along(lines, a, b)[best]
    assert np.linalg.norm(lines.ends[best, 1] - b) < 5e-3
    wire = along(lines, *WIRE)
    assert wire.any()
    assert lines.probabilities[wire].max() < 0.5
    np.testing.assert_allclose(lines.classes.sum(axis=1), 1)


def test_a_needle_that_is_pushed_slowly_is_found():
    """It passes a bin in more than a second, so the last few volumes show it rest."""
    slower = 5
    lines = followed(volumes(True, False, slower)).hypotheses
    best = int(lines.probabilities.argmax())
    assert lines.probabilities[best] > 0.95
    assert along(lines, *pushed(lines.time / slower))[best]


def test_a_needle_is_found_in_speckle_that_is_drawn_anew_with_each_volume():
    """Nothing repeats itself but the wire, and the tissue seems to move by chance only."""
    belief = followed(volumes(True, False, fresh=True))
    lines = belief.hypotheses
    best = int(lines.probabilities.argmax())
    assert lines.probabilities[best] > 0.95
    assert along(lines, *pushed(lines.time))[best]
    assert np.linalg.norm(belief.memory[-1].displacement) < 1e-3


@pytest.mark.parametrize("moving", [False, True])
def test_a_structure_ahead_on_the_same_line_is_no_part_of_the_needle(moving):
    belief, surest = LineBelief(), []
    for volume in volumes(True, moving, ahead=20.0):
        belief = follow(belief, volume)
        lines = belief.hypotheses
        best = int(lines.probabilities.argmax())
        if lines.probabilities[best] > 0.9:
            surest.append(np.linalg.norm(lines.ends[best, 1] - pushed(lines.time)[1]))
    assert len(surest) > 3
    assert max(surest) < 6e-3


def test_a_line_along_one_at_rest_is_less_probably_a_needle():
    """Its odds fall by the ratio of how densely lines of a structure, and needles, lie there."""
    wall = np.array([[0.0, 0.05, 0.03], [0.06, 0.05, 0.03]])
    aside, along = np.array([0.0, 0.0, 3e-3]), wall[1] - wall[0]
    turn = np.radians(20)
    turned = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    others = {
        "aside": wall + aside,
        "farther": wall + 10 * aside,
        "beyond its end": wall + aside + along,
        "half beyond": wall + aside + along / 2,
        "across": wall.mean(axis=0) + (wall - wall.mean(axis=0)) @ np.transpose(turned),
    }
    ends = np.array([wall, *others.values()])
    lines = _new_lines(ends, ends, np.arange(len(ends)), 1)
    resting = np.log(np.full((len(ends), 6), 1e-9))
    resting[:, 2] = 0.0  # all rest, but only the first is long known to
    resting[1:, 0] = 0.0
    volume = volumes(False, False)[0]
    lines = replace(lines, classes=resting)
    lost = _of_structures(lines, lines, 1.0, volume)
    density = 1 / (2 * np.pi * (4e-3 * 0.05) ** 2) * np.prod(SPACING * np.array(SHAPE)) ** (2 / 3)
    near = density * np.exp(-0.5 * (3 / 4) ** 2)
    expected = [0.0, np.log1p(near), 0.0, 0.0, np.log1p(near / 2), 0.0]
    np.testing.assert_allclose(lost, expected, atol=0.01)


def test_older_volumes_are_remembered_more_sparsely_while_the_tissue_is_the_same():
    images = [replace(each, time=0.6 * n) for n, each in enumerate(2 * volumes(False, False))]
    gaps = np.diff([each.volume.time for each in followed(images).memory])
    assert gaps.sum() > 0.9 * images[-1].time
    assert gaps[0] > 3 * gaps[-1]
    others = [replace(each, intensities=each.intensities[:: (-1) ** n])
              for n, each in enumerate(images[:COUNT])]  # fmt: skip
    gaps = np.diff([each.volume.time for each in followed(others).memory])
    np.testing.assert_allclose(gaps, 0.6)


def test_where_no_needle_comes_none_is_found():
    lines = followed(volumes(False, True)).hypotheses
    assert lines.probabilities.max() < 0.5
    wire = np.flatnonzero(along(lines, *WIRE))
    assert len(wire)
    kinds = [LINE_CLASSES[n] for n in lines.classes[wire].argmax(axis=1)]
    assert "needle" not in kinds


def test_the_history_of_a_needle_shows_its_tip_advance(pushed_in):
    explained = explain_lines(pushed_in)
    assert explained.lines.probabilities[0] == explained.lines.probabilities.max() > 0.95
    # The contrast stands out as far as the needle has come in each volume, and not beyond.
    entry = explained.lines.ends[0, 0]
    beside = 3e-3
    history = explained.times, explained.contrasts, explained.seen
    for time, contrasts, seen in zip(*history, strict=True):
        tip = float((pushed(time)[1] - entry) @ K)
        before = seen & (explained.a > 0) & (explained.a < tip - beside)
        beyond = seen & (explained.a > tip + beside)
        assert beyond.any()
        assert contrasts[beyond].mean() < 2
        if before.any():
            assert contrasts[before].mean() > 5


def test_a_volume_without_contact_does_not_move_the_tissue():
    images = volumes(False, False)
    dark = [replace(each, intensities=np.ones(SHAPE, np.uint8)) for each in images[:2]]
    for remembered in followed([*dark, *images[2:8]]).memory:
        assert np.linalg.norm(remembered.displacement) < 0.3e-3


def test_what_comes_out_of_a_shadow_is_no_needle():
    """The border of the shadow goes along the wire as fast as a needle would."""
    images, x = [], SPACING * np.arange(SHAPE[0])[:, np.newaxis, np.newaxis]
    for each in volumes(False, False):
        shaded = np.clip((x - 0.01 - 9e-3 * each.time) / 2e-3, 0, 1)
        levels = np.clip(each.intensities - 110 * shaded, 1, 255).astype(np.uint8)
        images.append(replace(each, intensities=levels))
    belief = followed(images)
    for remembered in belief.memory:
        assert np.linalg.norm(remembered.displacement) < 1e-3
    assert along(belief.hypotheses, *WIRE).any()
    assert belief.hypotheses.probabilities.max() < 0.5


def test_the_same_volumes_give_the_same_bits():
    first, second = (followed(volumes(True, True)[:6]).hypotheses for _ in range(2))
    for name in ("ends", "probabilities", "classes", "looks", "looked", "numbers"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_leaf_follows_until_a_needle_is_surely_tracked():
    leaf = LineFollower(sure=0.9, period=1.0)
    context = leaf.CreateDefaultContext()
    fix = lambda port, value: leaf.GetInputPort(port).FixValue(context, Value[object](value))  # noqa: E731
    lines = lambda: leaf.GetOutputPort("lines").Eval(context)  # noqa: E731
    searching = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
    fix("estimate", searching)
    fix("volume", NotFound("no sweep"))
    assert lines().reason == "no sweep"
    images = volumes(False, False)
    for each, shown in zip(images, (0.0, 0.0, 0.6), strict=False):  # the second comes too soon
        fix("volume", each)
        before = lines()
        leaf.ExecuteForcedEvents(context)
        after = lines()
        assert before.time == after.time == shown
        np.testing.assert_array_equal(before.ends, after.ends)
        np.testing.assert_array_equal(before.probabilities, after.probabilities)
    curve = NeedleCurve(pushed(0.0))
    tracking = NeedleEstimate(
        TrackingMode.TRACKING, 0.0, curve, np.zeros((2, 3)), 1e-6 * np.eye(12), 0.0
    )
    fix("estimate", replace(tracking, probability=0.8))
    fix("volume", images[3])
    assert lines()
    fix("estimate", replace(tracking, probability=0.95))
    assert lines().reason == "a needle is being tracked"
    leaf.ExecuteForcedEvents(context)
    assert not leaf.GetOutputPort("explanation").Eval(context)
    belief = leaf.GetOutputPort("belief").Eval(context)
    assert belief.time == images[3].time
    assert len(belief.lines) == len(belief.memory) == 0
