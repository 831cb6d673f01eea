"""Contrast and fit of lines, in volumes whose lines are known exactly."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.signals import Volume
from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_contrast import (
    ALL_NEW,
    BIN,
    BINS,
    MIDDLES,
    Change,
    LineLevels,
    across,
    change_between,
    line_levels,
    log_ratio,
    repeat_ratio,
    stretches,
)
from sonoservo.systems.tracking.line_fit import fitted_lines

SPACING = np.array([0.8e-3, 0.6e-3, 1.0e-3])
SIZE = np.array([80e-3, 50e-3, 50e-3])
MIDDLE = SIZE / 2
K = np.array([0.9, 0.3, -0.25]) / np.linalg.norm([0.9, 0.3, -0.25])
SIGMA, HEIGHT, HALF = 1.0e-3, 10.0, 15e-3


def volume(kind, seed=None, k=K, at=MIDDLE):
    """A blurred line or sheet, 10 dB above even tissue or speckle."""
    p = np.moveaxis(np.indices(np.round(SIZE / SPACING).astype(int)), 0, -1) * SPACING
    along = (p - at) @ k
    if kind == "sheet":
        away = (p - at) @ across(k[np.newaxis])[0, 1]
    else:
        away = np.linalg.norm(p - at - along[..., np.newaxis] * k, axis=-1)
    shape = np.exp(-0.5 * (away / SIGMA) ** 2) * (np.abs(along) < HALF)
    levels = 100 + 4 * HEIGHT * shape * (kind != "nothing")
    if seed is not None:
        levels += np.random.default_rng(seed).normal(0.0, 12.0, levels.shape)
    return Volume(
        np.clip(levels, 1, 255).astype(np.float32), np.zeros(3), SPACING, RigidTransform(), 0.0,
        decibels_per_level=0.25,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "inside"),
    [("line", HEIGHT * (0.2 + 0.8 * np.exp(-0.5 * 0.6**2))), ("sheet", 0.0), ("nothing", 0.0)],
)
def test_a_line_is_brighter_than_what_lies_beside_it(kind, inside):
    """A fifth of the core lies on the line, and the rest 0.6 mm beside it."""
    levels, contrasts = line_levels(volume(kind), MIDDLE[np.newaxis], K[np.newaxis])
    assert contrasts.shape == levels.shape == (1, BINS)
    seen = ~np.isnan(contrasts)
    np.testing.assert_array_equal(np.isnan(levels), ~seen)
    on_line = np.abs(MIDDLES) < HALF - 2 * BIN
    assert seen[0, on_line].all()
    np.testing.assert_allclose(contrasts[0, on_line], inside, atol=1.2)
    beyond = seen[0] & (np.abs(MIDDLES) > HALF + 3 * BIN)
    np.testing.assert_allclose(contrasts[0, beyond], 0, atol=0.3)
    points = MIDDLE + np.outer(MIDDLES, K)
    assert np.mean(seen[0] == np.all((points > 0) & (points < SIZE), axis=1)) > 0.9


def test_what_is_not_seen_is_weak_evidence_against_a_line():
    contrasts = np.full((1, 12), 6.0, np.float32)
    contrasts[0, 5:7] = np.nan
    firsts, lasts, sums = stretches(contrasts)
    assert (firsts[0], lasts[0]) == (0, 11)
    assert sums[0] == pytest.approx(10 * log_ratio(np.array([6.0]))[0] - 1.0)


def test_a_level_far_beyond_all_models_does_not_repeat_a_dark_one():
    """However bright a needle is, that it came is more probable than that nothing changed."""
    before = np.full((1, 1), 5.0)
    for contrast in (10.0, 25.0, 45.0, 60.0):
        now = LineLevels(*np.full((2, 1, 1), contrast, np.float32))
        repeats = repeat_ratio(now, before, Change(0.05, 0.2))
        assert 0.95 * repeats[0, 0] < 0.05 * np.exp(log_ratio(now.contrasts)[0, 0])


@pytest.mark.parametrize(("renewed", "scale"), [(0.01, 1.0), (0.4, 1.5)])
def test_how_contrasts_change_is_measured_from_them(renewed, scale):
    rng = np.random.default_rng(4)

    def drawn(count):
        """Half of them are shown by lines, half by nothing."""
        return np.where(
            rng.random(count) < 0.5, rng.normal(4.6, 3.0, count), rng.normal(-1.2, 1.8, count)
        )

    before = drawn(4000)
    now = before + scale * rng.standard_t(5, 4000)
    now = np.where(rng.random(4000) < renewed, drawn(4000), now)
    before[:100] = now[50:150] = np.nan
    found = change_between(LineLevels(now, now), before)
    assert found.renewed == pytest.approx(renewed, abs=0.01 + 0.15 * renewed)
    assert found.scale == pytest.approx(scale, rel=0.08)
    assert change_between(LineLevels(now, now), np.full(4000, np.nan)) == ALL_NEW
    assert change_between(LineLevels(now, now), now).scale < 0.1


def test_a_displaced_and_turned_line_is_fitted():
    """The line lies wherever it lies between the cells and directions that are searched."""
    rng = np.random.default_rng(0)
    k = K + rng.uniform(-0.1, 0.1, 3)
    k /= np.linalg.norm(k)
    at = MIDDLE + rng.uniform(-3e-3, 3e-3, 3)
    image = volume("line", 0, k, at)
    ends = fitted_lines(image, cells_of(image), 10)[0].ends
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    assert abs(direction @ k) > np.cos(np.radians(2))
    away = ends.mean(axis=0) - at
    assert np.linalg.norm(away - away @ k * k) < 0.5e-3
    np.testing.assert_allclose(np.sort((ends - at) @ k), [-HALF, HALF], atol=2.5e-3)
