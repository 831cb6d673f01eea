from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from independent_images import volume_case
from independent_images.cases import draw_kinds
from random_scans import random_scan
from synthetic_volumes import GEOMETRY, Scene, entry_on_side

from sonoservo.systems.signals import NeedleCurve
from sonoservo.systems.tracking import NeedleLocalizerParameters
from sonoservo.systems.tracking import needle_line as module
from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_fit import fitted_lines
from sonoservo.systems.tracking.needle_line import log_odds, needle_lines, stretches_between
from sonoservo.systems.tracking.search_region import found_again

ENTRY = entry_on_side()
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
NEEDLE = np.array([ENTRY, ENTRY + 0.035 * K])
LEAST = NeedleLocalizerParameters().min_probability
SCENE = Scene(seed=5, spacing=1e-3)


@lru_cache
def volume():
    return SCENE.volume(1, lambda time: NEEDLE)


def test_the_needle_is_the_most_probable_line():
    first, *others = needle_lines(volume())
    assert abs(first.direction @ K) > np.cos(np.radians(3))
    assert all(each.probability < first.probability for each in others)


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
    found = odds(SCENE.volume(1, lambda time: ends), ends)
    assert (found > -3) == possible


def test_lines_along_one_needle_share_its_probability():
    """The one that is likely itself and has the others along it stands for all."""
    part, beside = ENTRY + np.outer([0.0, 0.02], K), NEEDLE + np.array([0.0, 0.01, 0.0])
    sheet = np.array([beside[0], beside[0] + 0.07 * K])
    steep = NEEDLE[0] + np.outer([0.0, 0.007], K + np.cross(K, [0.0, 0.25, 0.0]))
    ends, log_odds = np.array([part, NEEDLE, beside, sheet, steep]), [1.0, 1.0, 0.0, -9.0, -1.0]
    found = module._needles(ends, np.array(log_odds))
    assert len(found) == 3
    np.testing.assert_array_equal(found[0].ends, NEEDLE)
    assert found[0].probability == pytest.approx(2 * np.e / (1 + 2 * np.e))
    assert found[1].probability == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_array_equal(found[2].ends, steep)


def odds(image, ends, **options):
    return log_odds(image, ends[np.newaxis], fits(image), **options)[0]


@lru_cache
def fits(image):
    return fitted_lines(image, cells_of(image))


def test_a_dark_beginning_does_not_count_against_the_looks_of_a_stretch():
    inside = NEEDLE[1] - np.outer([0.02, 0.0], K)
    image = SCENE.volume(1, lambda time: inside)
    found = odds(image, inside, dark_entry=True)
    assert found > odds(image, inside)
    assert found > odds(image, inside + np.array([0.0, 0.01, 0.01]), dark_entry=True) + 2
    assert np.isnan(odds(image, inside + 1.0))


def test_a_longer_stretch_than_the_needle_is_less_probable():
    longer = np.array([NEEDLE[0], NEEDLE[0] + 0.07 * K])
    found, seen = stretches_between(volume(), np.array([NEEDLE, longer]))
    assert seen.all()
    assert found.evidence[1] < found.evidence[0]
    assert odds(volume(), longer) < odds(volume(), NEEDLE)


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


@pytest.mark.parametrize(
    "changes",
    [{"start": 0.012, "stop": 0.035}, {"start": 0.0, "stop": 0.006}],
    ids=["gap", "short"],
)
def test_what_starts_inside_or_is_short_is_less_like_a_needle(changes):
    ends = ENTRY + np.outer([changes["start"], changes["stop"]], K)
    scene = SCENE.volume(1, lambda time: ends)
    assert odds(scene, ends) < odds(volume(), NEEDLE) - 0.5


def test_the_border_of_dark_tissue_is_no_needle():
    image = SCENE.volume(1)
    p_P = image.position(np.moveaxis(np.indices(image.intensities.shape), 0, -1))
    along = (p_P - NEEDLE[0]) @ K
    depth = (NEEDLE[0] + along[..., np.newaxis] * K)[..., 1]
    beneath = (p_P[..., 1] > depth) & (image.intensities > 0)
    dark = np.where(beneath, image.intensities // 3 + 1, image.intensities)
    assert all(each.probability < LEAST for each in needle_lines(replace(image, intensities=dark)))


def turned(angle_deg):
    angle = np.radians(angle_deg)
    across = np.cross(K, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    return NEEDLE[1] + np.outer([-0.035, 0.0], np.cos(angle) * K + np.sin(angle) * across)


def is_along(line, ends):
    """Whether a line lies along a needle, (2, 3) ends in P, to 3 mm and 10 deg."""
    length = np.linalg.norm(ends[1] - ends[0])
    k = (ends[1] - ends[0]) / length
    points = np.linspace(*line.ends, 9) - ends[0]
    away = points - np.clip(points @ k, 0, length)[:, np.newaxis] * k
    near = np.linalg.norm(away, axis=1).mean() < 3e-3
    return near and abs(line.direction @ k) > np.cos(np.radians(10))


@pytest.mark.parametrize(
    ("ends", "least", "most"),
    [
        (NEEDLE[::-1], 8.0, 10.0),
        (turned(20) + np.array([0.02, 0.0, 0.01]), -1.1, 1.0),
        (turned(87), -np.inf, -1.0),
        (NEEDLE + np.array([0.0, 0.03, 0.05]), -np.inf, -1.0),
        (NEEDLE[1] + np.outer([-0.0043, 0.0], K), -np.inf, 8.0),
    ],
    ids=["in its place", "moved with the phantom", "turned", "elsewhere", "short"],
)
def test_what_agrees_with_a_lost_needle_needs_less_evidence(ends, least, most):
    odds, found = found_again(0.0, ends, NeedleCurve(NEEDLE))
    assert least - 1e-6 <= odds <= most + 1e-6
    assert (found[1] - found[0]) @ (NEEDLE[1] - NEEDLE[0]) > 0


@pytest.mark.slow
def test_a_probability_is_the_share_of_needles():
    """In 320 volumes, half of them without a needle: own scans of seeds that were not fitted, and
    images of a generator that was not."""
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
