from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from independent_images import volume_case
from independent_images.cases import draw_kinds
from pydrake.math import RigidTransform, RollPitchYaw
from random_scans import random_scan
from synthetic_volumes import GEOMETRY, Scene, entry_on_side

from sonoservo.diagrams.app.volumes.locate import locate_in
from sonoservo.systems.localization import needle_line as module
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.tracking.line_profile import profile
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.needle_line import (
    NeedleLine,
    line_between,
    needle_lines,
    refined_line,
)
from sonoservo.systems.tracking.novelty import has_moved, is_new, rides_along
from sonoservo.systems.tracking.search_region import found_again

ENTRY = entry_on_side()
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
NEEDLE = np.array([ENTRY, ENTRY + 0.035 * K])
LEAST = NeedleLocalizerParameters().min_probability
SCENE = Scene(seed=5, spacing=1e-3)


@lru_cache
def volume():
    return SCENE.volume(1, lambda time: NEEDLE)


def test_a_rough_line_is_refined_and_cut_to_the_needle():
    rough = NEEDLE + np.array([[0.0, 2e-3, -1e-3], [0.0, -1.5e-3, 2e-3]])
    found = refined_line(volume(), rough)
    assert np.degrees(np.arccos(found.direction @ K)) < 1
    assert np.linalg.norm(found.ends[1] - NEEDLE[1]) < 2e-3
    assert found.entry_gap < 2e-3 < found.tip_gap
    assert found.probability > 0.9


def test_the_needle_is_the_most_probable_line():
    first, *others = needle_lines(volume())
    assert abs(first.direction @ K) > np.cos(np.radians(2))
    assert all(each.log_odds <= first.log_odds for each in others)


@pytest.mark.parametrize(
    ("frame", "lines", "depths", "possible"),
    [
        (1, [1, 1], [2e-3, 60e-3], False),
        (1, [2, 60], [40e-3, 40e-3], True),
        (0, [2, 60], [40e-3, 40e-3], False),
    ],
    ids=["where two sides meet", "in an outer frame", "in the outermost frame"],
)
def test_a_line_along_the_border_of_the_field_of_view_is_no_needle(frame, lines, depths, possible):
    samples = np.array(depths) / GEOMETRY.sample_pitch
    ends = GEOMETRY.position(frame, np.array(lines), samples, 1)
    found = refined_line(SCENE.volume(1, lambda time: ends), ends)
    assert np.isfinite(found.log_odds) == possible


def test_a_whole_needle_takes_the_place_of_its_parts(monkeypatch):
    """Unless it does not look like a needle: a part of a sheet may."""
    part, beside = ENTRY + np.outer([0.0, 0.02], K), NEEDLE + np.array([0.0, 0.01, 0.0])
    sheet = np.array([beside[0], beside[0] + 0.07 * K])
    lines = [
        NeedleLine(part, 0.1, 0.0, 0.05, log_odds=5.0),
        NeedleLine(NEEDLE, 0.2, 0.0, 0.04, log_odds=2.0),
        NeedleLine(beside, 0.2, 0.0, 0.04, log_odds=4.0),
        NeedleLine(sheet, 0.3, 0.0, 0.01, log_odds=-1.0),
    ]
    steep = NEEDLE[0] + np.outer([0.0, 0.007], K + np.cross(K, [0.0, 0.25, 0.0]))
    lines.append(NeedleLine(steep, 0.1, 0.0, 0.05, log_odds=9.0))  # near, but not along
    remaining = iter(lines)
    monkeypatch.setattr(module, "bright_lines", lambda volume, count: lines)
    monkeypatch.setattr(module, "refined_line", lambda volume, ends: next(remaining))
    found = needle_lines(volume())
    assert [each.log_odds for each in found] == [9.0, 5.0, 4.0, -1.0]
    np.testing.assert_array_equal(found[1].ends, NEEDLE)


@pytest.mark.parametrize(
    ("bright", "seen", "side"),
    [(3, 16, 50.0), (4, 16, 90.0), (1, 9, 50.0), (2, 9, 90.0), (1, 4, 90.0)],
)
def test_few_bright_sectors_beside_a_line_count_for_speckle(bright, seen, side):
    angles = 2 * np.pi / 16 * np.arange(16)
    x, y = np.indices((31, 31)) - 15
    sector = np.round(np.arctan2(y, x) / angles[1]).astype(int) % 16
    section = np.where((np.hypot(x, y) > 5) & (sector < bright), 90.0, 50.0)
    section[(np.hypot(x, y) > 5) & (sector >= seen)] = 0.0
    section[15, 15] = 100.0
    points = np.array([[15.0, 15.0, z] for z in range(2, 18)])
    ring = 10.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(16)], axis=1)
    levels = np.repeat(section[..., np.newaxis], 20, axis=2)
    line, sides, _ = profile(levels, levels > 0, points, np.zeros((1, 3)), ring[np.newaxis], 3, 0.2)
    np.testing.assert_allclose(line, 100.0)
    np.testing.assert_allclose(sides, side)


def test_a_longer_stretch_than_the_needle_is_less_probable():
    exact = line_between(volume(), NEEDLE)
    longer = line_between(volume(), np.array([NEEDLE[0], NEEDLE[0] + 0.07 * K]))
    assert longer.evidence < exact.evidence
    assert longer.log_odds < exact.log_odds
    assert line_between(volume(), NEEDLE + 1.0) is None


@pytest.mark.parametrize("needle", [True, False])
def test_a_bright_sheet_is_no_needle(needle):
    image = volume() if needle else SCENE.volume(1)
    p_P = image.position(np.moveaxis(np.indices(image.intensities.shape), 0, -1))
    normal = np.array([0.1, 1.0, -0.2]) / np.linalg.norm([0.1, 1.0, -0.2])
    near = np.abs((p_P - [0.0, 0.068, 0.0]) @ normal) < 1e-3
    sheet = np.where(near & (image.intensities > 0), np.uint8(230), image.intensities)
    lines = needle_lines(replace(image, intensities=sheet))
    if needle:
        assert abs(lines[0].direction @ K) > np.cos(np.radians(2))
        lines = [each for each in lines if abs(each.direction @ K) < np.cos(np.radians(10))]
    assert all(each.probability < LEAST for each in lines)


def test_a_sheet_that_moved_is_refused_by_far():
    image = SCENE.volume(1)
    p_P = image.position(np.moveaxis(np.indices(image.intensities.shape), 0, -1))
    level = (np.abs(p_P[..., 1] - 0.068) < 1e-3) & (image.intensities > 0)
    sheet = replace(image, intensities=np.where(level, np.uint8(230), image.intensities))
    line = line_between(sheet, np.array([[-0.08, 0.068, 0.0], [-0.02, 0.068, 0.0]]))
    assert -np.inf < line.log_odds < NeedleLocalizerParameters().min_odds


@pytest.mark.parametrize(
    "changes",
    [{"start": 0.012, "stop": 0.035}, {"start": 0.0, "stop": 0.006}],
    ids=["gap", "short"],
)
def test_what_starts_inside_or_is_short_is_no_needle(changes):
    ends = ENTRY + np.outer([changes["start"], changes["stop"]], K)
    scene = SCENE.volume(1, lambda time: ends)
    assert line_between(scene, ends).probability == 0


def test_the_border_of_dark_tissue_is_no_needle():
    image = SCENE.volume(1)
    p_P = image.position(np.moveaxis(np.indices(image.intensities.shape), 0, -1))
    along = (p_P - NEEDLE[0]) @ K
    depth = (NEEDLE[0] + along[..., np.newaxis] * K)[..., 1]
    beneath = (p_P[..., 1] > depth) & (image.intensities > 0)
    dark = np.where(beneath, image.intensities // 3 + 1, image.intensities)
    assert all(each.probability < LEAST for each in needle_lines(replace(image, intensities=dark)))


LAST = NeedleCurve(NEEDLE)


def turned(angle_deg):
    angle = np.radians(angle_deg)
    across = np.cross(K, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    return NEEDLE[1] + np.outer([-0.035, 0.0], np.cos(angle) * K + np.sin(angle) * across)


def test_a_lost_needle_in_its_place_needs_less_evidence():
    odds, ends = found_again(0.0, NEEDLE[::-1], LAST)
    assert odds == pytest.approx(1.0)
    np.testing.assert_array_equal(ends, NEEDLE)


@pytest.mark.parametrize(
    "ends",
    [turned(87), NEEDLE + np.array([0.0, 0.03, 0.05]), NEEDLE[1] + np.outer([-0.0043, 0.0], K)],
    ids=["turned", "elsewhere", "short"],
)
def test_what_disagrees_with_the_lost_needle_needs_more_evidence(ends):
    assert found_again(0.0, ends, LAST)[0] < -1


def test_moderate_moves_of_the_phantom_are_allowed():
    moved = turned(20) + np.array([0.02, 0.0, 0.01])
    assert found_again(2.5, moved, LAST)[0] > 1.4


def scene(count, needle=None, aside=0.0, turn=0.0):
    """Volumes of a probe that was moved aside and turned; the needle stays in W."""
    X_WP = RigidTransform(RollPitchYaw(0.0, turn, 0.0), [aside, 0.0, 0.0])
    ends = needle if needle is None else lambda time: needle
    return [SCENE.volume(number, ends, X_WP) for number in range(count)]


@pytest.mark.parametrize("must_come", [True, False])
def test_a_line_that_earlier_volumes_lack_is_new(must_come):
    assert is_new(volume(), NEEDLE, tuple(scene(3)), must_come=must_come)


@pytest.mark.parametrize("must_come", [True, False])
def test_a_line_that_was_there_first_is_not_new(must_come):
    earlier = (*scene(1, NEEDLE), *scene(4))
    assert not is_new(volume(), NEEDLE, earlier, must_come=must_come)
    displaced = NEEDLE + np.array([0.0, 0.004, 0.0])
    assert not is_new(volume(), NEEDLE, tuple(scene(1, displaced)), must_come=must_come)


def test_a_line_that_came_stays_new():
    assert is_new(volume(), NEEDLE, (*scene(3), *scene(4, NEEDLE)), must_come=True)


def test_too_few_looks_do_not_show_that_a_line_came():
    for earlier in ((), tuple(scene(2)), (*scene(2), *scene(4, NEEDLE))):
        assert not is_new(volume(), NEEDLE, earlier, must_come=True)
        assert is_new(volume(), NEEDLE, earlier)


@pytest.mark.parametrize("moved", [{"aside": 0.003}, {"turn": np.radians(3)}])
def test_looks_from_elsewhere_do_not_show_that_a_line_came(moved):
    assert not is_new(volume(), NEEDLE, tuple(scene(5, **moved)), must_come=True)
    assert not is_new(volume(), NEEDLE, (*scene(1, NEEDLE, **moved), *scene(3)), must_come=True)


def test_looks_from_far_away_show_nothing():
    assert is_new(volume(), NEEDLE, (*scene(2, NEEDLE, aside=0.02), *scene(3)), must_come=True)


@pytest.mark.parametrize("must_come", [True, False])
def test_something_bright_beyond_the_needle_is_no_earlier_needle(must_come):
    """A needle is aimed at a target."""
    target = NEEDLE[1] + np.outer([0.008, 0.022], K)
    before = [SCENE.volume(number, lambda time: target) for number in range(4)]
    both = np.maximum(volume().intensities, before[1].intensities)
    image = replace(volume(), intensities=both)
    assert is_new(image, NEEDLE, tuple(before), must_come=must_come)
    assert has_moved(image, NEEDLE, tuple(before))
    assert not has_moved(image, NEEDLE, tuple(scene(4, NEEDLE)))


def test_more_looks_must_show_a_line_than_lack_it():
    lacking, showing = scene(4), scene(4, NEEDLE)
    for lack, show, there in ((0, 3, True), (3, 4, True), (3, 3, False), (0, 2, False)):
        earlier = (*lacking[:lack], *showing[:show])
        assert has_moved(volume(), NEEDLE, earlier) is not there


SHORTER = np.array([ENTRY, ENTRY + 0.022 * K])


def test_a_line_that_grew_is_new_wherever_it_was_seen_from():
    lacking, shorter = scene(3, aside=-0.01), scene(2, SHORTER, aside=-0.01)
    whole = scene(2, NEEDLE, aside=-0.01)
    assert is_new(volume(), NEEDLE, (*lacking, *shorter, *whole), must_come=True)
    for earlier in (lacking, lacking[:2] + shorter, lacking + shorter[:1], shorter + lacking):
        assert not is_new(volume(), NEEDLE, tuple(earlier), must_come=True)
    assert not is_new(volume(), NEEDLE, (*whole[:1], *lacking, *shorter), must_come=True)
    lacking_elsewhere = scene(3, aside=0.01)
    assert not is_new(volume(), NEEDLE, (*lacking_elsewhere, *shorter, *whole), must_come=True)
    partly_out_of_view = scene(3, aside=0.02)
    assert not is_new(volume(), NEEDLE, (*partly_out_of_view, *shorter), must_come=True)


ACROSS = np.array([0.0, 0.0, 0.012])
ALONG = 0.012 * K


def moved_along(step, line_moves, count=3):
    """Volumes of a probe that was moved by a step in W; the line moves with it, or stays."""
    ends = NEEDLE + step if line_moves else NEEDLE
    return [
        SCENE.volume(number, lambda time: ends, RigidTransform(step)) for number in range(count)
    ]


def test_a_line_that_rides_along_with_the_probe_is_not_new():
    """A reverberation does, and the glint of a level layer."""
    riding = moved_along(ACROSS, line_moves=True)
    assert rides_along(volume(), NEEDLE, tuple(riding))
    assert not is_new(volume(), NEEDLE, (*riding, *scene(3)), must_come=True)
    assert not rides_along(volume(), NEEDLE, tuple(riding[:2]))
    lacking = [SCENE.volume(number, None, RigidTransform(ACROSS)) for number in range(3)]
    assert not rides_along(volume(), NEEDLE, (*riding, *lacking))


def test_a_line_at_rest_does_not_ride_along():
    resting = moved_along(ACROSS, line_moves=False)
    assert not rides_along(volume(), NEEDLE, tuple(resting))
    assert is_new(volume(), NEEDLE, (*scene(3), *resting), must_come=True)


def test_a_probe_that_moves_along_a_line_does_not_tell_whether_it_rides_along():
    assert not rides_along(volume(), NEEDLE, tuple(moved_along(ALONG, line_moves=True)))


def test_what_moved_must_have_been_lacking_where_it_must_come():
    for lack, moved in ((0, False), (2, False), (3, True)):
        assert has_moved(volume(), NEEDLE, tuple(scene(lack)), must_come=True) is moved
        assert has_moved(volume(), NEEDLE, tuple(scene(lack)))
    assert not has_moved(volume(), NEEDLE, (*scene(3), *scene(4, NEEDLE)), must_come=True)
    for aside, needle, moved in ((0.003, None, True), (0.003, SHORTER, False), (0.02, None, False)):
        earlier = tuple(scene(4, needle, aside=aside))
        assert has_moved(volume(), NEEDLE, earlier, must_come=True) is moved


def test_a_line_that_was_fainter_has_not_come():
    """What a volume shows up to its end, if with less than half the evidence, it does not lack."""
    faint = [
        replace(each, intensities=np.uint8(0.665 * each.intensities + 0.335 * volume().intensities))
        for each in scene(3)
    ]
    assert not has_moved(volume(), NEEDLE, tuple(faint), must_come=True)
    assert has_moved(volume(), NEEDLE, tuple(faint))


def test_a_line_that_is_hardly_brighter_than_speckle_is_not_new():
    ends = NEEDLE + np.array([0.0, 0.015, 0.01])
    assert not is_new(SCENE.volume(1), ends, tuple(scene(3)), must_come=True)


def test_volumes_before_the_probe_has_landed_lack_nothing():
    air = [replace(each, intensities=each.intensities // 8) for each in scene(5)]
    assert not is_new(volume(), NEEDLE, tuple(air), must_come=True)
    assert is_new(volume(), NEEDLE, (*air, *scene(3)), must_come=True)


@pytest.mark.slow
def test_structures_of_independent_images_are_no_needles():
    false = right = count = 0
    for seed in range(100, 140):
        for needle in (True, False):
            rng = np.random.default_rng([seed, int(needle)])
            kinds = draw_kinds(rng) if seed % 2 else ()
            image, truth = volume_case(rng, needle, kinds)
            found = locate_in(image, seed=seed)
            if truth is None:
                false += bool(found)
            elif truth.length * np.mean(truth.visible) > 15e-3:
                count += 1
                right += bool(found) and np.linalg.norm(found.curve.tip - truth.tip) < 5e-3
    assert false == 0
    assert right > 0.45 * count


def is_along(line, ends):
    """Whether a line lies along a needle, (2, 3) ends in P, to 3 mm and 10 deg."""
    length = np.linalg.norm(ends[1] - ends[0])
    k = (ends[1] - ends[0]) / length
    points = np.linspace(*line.ends, 9) - ends[0]
    away = points - np.clip(points @ k, 0, length)[:, np.newaxis] * k
    near = np.linalg.norm(away, axis=1).mean() < 3e-3
    return near and abs(line.direction @ k) > np.cos(np.radians(10))


@pytest.mark.slow
def test_a_probability_is_the_share_of_needles():
    """In 320 volumes of two generators, half of them without a needle, none of them fitted to."""
    stated, right = [], []
    for seed in range(520, 600):
        for needle in (True, False):
            made = random_scan(seed, needle=needle)
            rng = np.random.default_rng([seed, int(needle)])
            image, truth = volume_case(rng, needle, draw_kinds(rng) if seed % 2 else ())
            true_ends = made.needle.control_points[[0, -1]] if needle else None
            other_ends = np.array([truth.entry, truth.tip]) if truth else None
            for each, ends in ((made.volume, true_ends), (image, other_ends)):
                for line in needle_lines(each.at_once())[:1]:
                    stated.append(line.probability)
                    right.append(needle and is_along(line, each.at_once().to_probe(ends)))
    stated, right = np.array(stated), np.array(right)
    for low, high in ((0.0, 0.2), (0.2, 0.8), (0.8, 1.0)):
        p, these = stated[here := (stated >= low) & (stated <= high)], right[here]
        print(f"{low} to {high}: stated {p.mean():.2f}, right {these.mean():.2f} of {len(p)}")
        assert abs(these.sum() - p.sum()) < 2.6 * np.sqrt((p * (1 - p)).sum()) + 1
