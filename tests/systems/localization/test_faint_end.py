"""Tests of the search for a faint part of a needle beyond its visible end."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from sonoservo.systems.localization.faint_end import FAINT_STD, faint_part

STEP, WIDTH = 0.25e-3, 1.5e-3
END, EXPECTED = 0.02, 0.05
A = np.arange(0, 0.08, STEP)


def speckle(seed, std=1.8):
    """Return the contrast of tissue in dB: as varied as a maximum over a tube, alike over a beam."""
    sigma = WIDTH / 2.355 / STEP * np.sqrt(2)
    noise = gaussian_filter1d(np.random.default_rng(seed).normal(size=len(A) + 100), sigma)
    return std * noise[50:-50] / noise.std()


def part(contrast, *, seen=None, end=END, expected=EXPECTED):
    seen = np.ones(len(A), bool) if seen is None else seen
    return faint_part(A, contrast, seen, end, expected, WIDTH)


def test_speckle_alone_is_no_needle():
    found = [part(speckle(seed)) for seed in range(300)]
    assert np.mean([length > 0 for length, _ in found]) <= 0.02
    assert np.mean([continues for _, continues in found]) <= 0.05


def test_a_faint_part_is_followed_to_its_end():
    """Its contrast of 3 dB is as large as that of every other sample of tissue."""
    tip = 0.045
    lengths = np.array([part(speckle(seed) + 3 * (tip > A))[0] for seed in range(300)])
    assert np.mean(lengths > 0) >= 0.9
    error = (END + lengths - tip)[lengths > 0]
    assert abs(np.median(error)) < 1.5e-3
    assert np.sqrt(np.mean(error**2)) < FAINT_STD


def test_a_gap_does_not_show_that_a_needle_ends():
    """After the gap it is faint again, but too short for that to be sure."""
    contrast = np.where((A < 0.025) | (A > 0.036), 2.6, 0.0)
    length, continues = part(contrast, end=0.025)
    assert length == 0 or continues
    assert not part(np.zeros(len(A)))[1]


def test_nothing_is_followed_beyond_the_expected_tip_or_the_field_of_view():
    bright = np.full(len(A), 5.0)
    assert END + part(bright)[0] <= EXPECTED + 3e-3 + STEP
    assert END + part(bright, seen=A < 0.04)[0] == pytest.approx(0.04, abs=2 * STEP)


def test_an_end_where_it_is_expected_is_the_tip():
    assert part(np.full(len(A), 5.0), expected=END + 2e-3) == (0.0, False)
    assert part(np.full(len(A), 5.0), expected=-np.inf) == (0.0, False)
