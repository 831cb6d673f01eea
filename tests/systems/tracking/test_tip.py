from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals.localization_explanation import AxisProfile
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.tracking.axis import axis_through
from sonoservo.systems.tracking.candidates import select_candidates
from sonoservo.systems.tracking.faint_end import FAINT_STD, faint_part
from sonoservo.systems.tracking.hidden_length import hidden_length
from sonoservo.systems.tracking.tip import (
    TipParameters,
    axis_profile,
    find_extent,
    most_evident_stretch,
)

SIGMA = 0.8e-3
PARAMETERS = TipParameters(beam_width=SIGMA * np.sqrt(8 * np.log(2)))
STEP = 0.25e-3
SCENE_VOLUME = Scene(seed=2).volume(0)
WIDTH, END, EXPECTED = 1.5e-3, 0.02, 0.05
A = np.arange(0, 0.08, STEP)


def profile(tip, level=12.0, gaps=(), start=0.0, noise=0.0, sigma=SIGMA, seen=0.08):
    """Contrast of a needle over a background of 20 dB, blurred at its ends, with gaps."""
    a = np.arange(-0.01, 0.08, STEP)
    amplitude = ndtr((a - start) / sigma) - ndtr((a - tip) / sigma)
    shaft = 20 * np.log10(10 ** (level / 20) * amplitude + 1)
    for begin, end in gaps:
        shaft[(a > begin) & (a < end)] = 0
    shaft = shaft + noise * np.random.default_rng(3).normal(size=len(a))
    return AxisProfile(a, np.outer(a, [1, 0, 0]), 20 + shaft, np.full(len(a), 20.0), a < seen)


@pytest.mark.parametrize("tip", [0.008, 0.02, 0.05])
@pytest.mark.parametrize("level", [12.0, 20.0, 30.0])
def test_a_blurred_edge_ends_at_the_tip_however_bright_it_is(tip, level):
    extent = find_extent(profile(tip, level), PARAMETERS)
    assert extent.tip == pytest.approx(tip, abs=0.5e-3)
    assert not extent.leaves


def test_a_wider_beam_blurs_the_tip_further_outwards():
    wide = TipParameters(beam_width=2 * PARAMETERS.beam_width)
    blurred = profile(0.03, 25.0, sigma=2 * SIGMA)
    assert find_extent(blurred, wide).tip == pytest.approx(0.03, abs=1e-3)
    assert find_extent(blurred, PARAMETERS).tip > find_extent(blurred, wide).tip + 0.5e-3


def test_gap_is_bridged_only_if_more_lies_beyond():
    gaps = [(0.02, 0.023)]
    assert find_extent(profile(0.04, gaps=gaps), PARAMETERS).tip > 0.038
    gaps = [(0.02, 0.039)]
    assert find_extent(profile(0.04, gaps=gaps), PARAMETERS).tip < 0.021


def test_noise_beyond_the_tip_does_not_lengthen():
    extent = find_extent(profile(0.03, noise=1.5), PARAMETERS)
    assert extent.tip == pytest.approx(0.03, abs=2e-3)


def test_evidence_grows_with_length():
    short, long = (find_extent(profile(tip), PARAMETERS).evidence for tip in (0.01, 0.03))
    assert 2.5 * short < long < 3.5 * short


def test_needle_that_leaves_the_field_of_view():
    assert find_extent(profile(0.09, seen=0.05), PARAMETERS).leaves
    assert find_extent(profile(0.09), PARAMETERS).leaves


def test_nothing_stands_out():
    assert not find_extent(profile(0.03, level=-40.0), PARAMETERS)


def test_most_evident_stretch_is_the_best_of_all():
    rng = np.random.default_rng(1)
    for _ in range(20):
        contrast, seen = rng.normal(3, 4, 30), rng.random(30) > 0.1
        options = {"step": 0.5, "neutral": 3.0, "max_evidence": 5.0}
        first, last, evidence = most_evident_stretch(contrast, seen, **options)
        each = np.where(seen, np.clip(contrast - 3, -3, 5), -3)
        sums = {(i, j): each[i : j + 1].sum() for i in range(30) for j in range(i, 30)}
        assert evidence == pytest.approx(0.5 * max(sums.values()))
        assert sums[first, last] == pytest.approx(max(sums.values()))
    first, last, evidence = most_evident_stretch(np.zeros(9), np.ones(9, bool), **options)
    assert last < first
    assert evidence == 0


@pytest.mark.parametrize("order", [2, 3])
def test_profile_follows_the_axis_in_any_pose(order):
    X_WP = RigidTransform(RollPitchYaw(2.0, 0.3, -0.5), [0.4, 0.1, 0.2])
    inside = entry_on_side() + np.array([8e-3, 4e-3, 0])
    ends = X_WP.multiply(np.array([inside, inside + np.array([0.025, 0.006, 0])]).T).T
    volume = Scene(seed=3, spacing=1.0e-3).volume(0, lambda time: ends, X_WP)
    axis = axis_through(np.linspace(*ends, order))
    along = axis_profile(volume, axis, -0.005, 0.04, PARAMETERS)
    extent = find_extent(along, PARAMETERS)
    np.testing.assert_allclose(along.p_W, axis.position(along.a))
    assert extent.start == pytest.approx(0, abs=2e-3)
    assert extent.tip == pytest.approx(np.linalg.norm(ends[1] - ends[0]), abs=1.5e-3)


def test_candidates_follow_the_needle_all_along():
    ends = np.array([entry_on_side(), entry_on_side() + np.array([0.05, 0.01, 0.004])])
    volume = Scene(seed=3, spacing=1.0e-3).volume(0, lambda time: ends)
    axis = axis_through(ends)
    length = np.linalg.norm(ends[1] - ends[0])
    found = select_candidates(
        volume,
        axis,
        start=0,
        stop=length,
        radius=6e-3,
        cross_section=4e-6,
        slab=2e-3,
    )
    a = axis.abscissa(found.p_P)
    counts = np.histogram(a, np.linspace(0, length, 6))[0]
    # As many where the needle is faint as where it is 20 dB brighter.
    assert counts.min() > 0.5 * counts.max()
    assert np.mean(axis.distance(found.p_P) < 2e-3) > 0.8
    assert axis.distance(found.p_P).max() <= 6e-3 + 1e-9
    assert found.weights.min() >= 0
    assert found.weights.max() <= 1


def test_candidates_outside_the_volume():
    volume = Scene(seed=3, spacing=1.0e-3).volume(0)
    axis = axis_through(np.array([[1.0, 0, 0], [2.0, 0, 0]]))
    options = {"start": 0, "stop": 0.02, "radius": 5e-3, "cross_section": 4e-6, "slab": 2e-3}
    assert len(select_candidates(volume, axis, **options).p_P) == 0


@pytest.mark.parametrize("dip_deg", [0, 30])
def test_the_blur_along_the_needle_is_the_volume_s_own(dip_deg):
    """Between the blur on the axis and its projection on the axis, else the parameter's."""
    volume = SCENE_VOLUME
    dip = np.deg2rad(dip_deg)
    k = np.array([np.cos(dip), np.sin(dip), 0])
    ends = volume.to_world(np.array([0, 0.045, 0]) + np.outer([-0.01, 0.01], k))[0]
    axis = axis_through(ends)
    assert axis_profile(volume, axis, 0.0, 0.02, PARAMETERS).beam_width is None
    measured = axis_profile(replace(volume, motion=None), axis, 0.0, 0.02, TipParameters())
    assert measured.beam_width is not None
    spread = PointSpread([0.0, 0.09], [2e-3, 2e-3], [6e-3, 6e-3], [0.5e-3, 0.5e-3])
    known = replace(volume, point_spread=spread)
    width = axis_profile(known, axis, 0.0, 0.02, PARAMETERS).beam_width
    middle = width[len(width) // 2]
    projected = np.hypot(2e-3 * k[0], 0.5e-3 * k[1])
    on_axis = 1 / np.hypot(k[0] / 2e-3, k[1] / 0.5e-3)
    assert middle == pytest.approx((projected + on_axis) / 2, rel=0.02)


@pytest.mark.parametrize("sigma", [0.5e-3, 0.8e-3, 1.2e-3])
def test_a_known_blur_is_undone_whatever_the_parameter_says(sigma):
    blurred = profile(0.03, 20.0, sigma=sigma)
    width = np.full(len(blurred.a), sigma * np.sqrt(8 * np.log(2)))
    extent = find_extent(replace(blurred, beam_width=width), TipParameters(beam_width=9e-3))
    assert extent.tip == pytest.approx(0.03, abs=0.5 * sigma)


def faded(tip, length, level=20.0):
    """Profile of a needle whose contrast falls over a length before its end."""
    sharp = profile(tip, level)
    fade = np.clip((tip - sharp.a) / length, 0, 1)
    return replace(sharp, level=20 + (sharp.level - 20) * fade)


@pytest.mark.parametrize("level", [16.0, 25.0])
def test_a_clear_and_abrupt_end_is_known_to_a_fraction_of_the_blur(level):
    extent = find_extent(profile(0.03, level), PARAMETERS)
    assert extent.tip_std == pytest.approx(0.45 * SIGMA, rel=0.1)


def test_the_longer_a_needle_fades_the_less_is_known_about_its_tip():
    stds = [find_extent(faded(0.03, length), PARAMETERS).tip_std for length in (1e-4, 8e-3, 16e-3)]
    assert stds[0] < stds[1] < stds[2]
    assert stds[2] > 2 * stds[0]


def test_the_tip_of_a_faint_needle_is_uncertain_and_no_shorter():
    clear, faint = (find_extent(profile(0.03, level), PARAMETERS) for level in (20.0, 6.0))
    assert faint.tip_std > 3 * clear.tip_std
    assert faint.tip == pytest.approx(0.03, abs=1.5e-3)


def test_a_needle_fainter_than_any_end_has_a_tip_that_is_not_known():
    extent = find_extent(profile(0.03, -6.0), PARAMETERS)  # 3.5 dB above the background
    assert extent.tip == pytest.approx(0.03, abs=3e-3)
    assert extent.tip_std > 5e-3


def test_a_rough_end_blurs_as_an_intensity_and_a_mirror_as_an_amplitude():
    """Simulated: points with random phases, and points in phase, that end at 30 mm."""
    rng = np.random.default_rng(5)
    a = np.arange(-0.01, 0.05, STEP)
    blur = np.exp(-((a[:, None] - a) ** 2) / (2 * SIGMA**2))
    ends = []
    for level, rough in [(18.0, True)] * 60 + [(30.0, False)]:
        phases = rng.uniform(0, 2 * np.pi, len(a)) if rough else np.zeros(len(a))
        echo = np.abs(blur @ ((np.abs(a - 0.015) < 0.015) * np.exp(1j * phases)))
        level = 20 * np.log10(10 ** (level / 20) * echo / np.sqrt(np.mean(echo[50:110] ** 2)) + 1)
        line = AxisProfile(a, np.outer(a, [1, 0, 0]), 20 + level, np.full(len(a), 20.0), a < 0.04)
        ends.append(find_extent(line, PARAMETERS).tip)
    assert np.median(ends[:-1]) == pytest.approx(0.03, abs=0.4e-3)
    assert ends[-1] == pytest.approx(0.03, abs=0.3e-3)


def test_without_gaps_nothing_is_hidden():
    assert hidden_length(np.zeros(80, dtype=bool), STEP) == (0.0, 0.0)


def test_what_is_hidden_is_what_a_tip_drawn_at_random_has_before_it():
    faint = np.zeros(160, dtype=bool)
    faint[10:30] = faint[60:64] = faint[100:148] = True
    edges = STEP * np.array([[10, 30], [60, 64], [100, 148]])
    tips = np.random.default_rng(5).uniform(0, 160 * STEP, 200_000)
    hidden = np.zeros_like(tips)
    for begin, end in edges:
        hidden += np.where((tips > begin) & (tips < end), tips - begin, 0.0)
    mean, std = hidden_length(faint, STEP)
    assert mean == pytest.approx(hidden.mean(), rel=0.01)
    assert std == pytest.approx(hidden.std(), rel=0.01)


def test_a_needle_seen_with_gaps_is_longer_and_less_certain():
    whole = find_extent(profile(0.04), PARAMETERS)
    gaps = find_extent(profile(0.04, gaps=[(0.01, 0.014), (0.024, 0.028)]), PARAMETERS)
    assert 0 < gaps.tip - whole.tip < 1e-3
    assert gaps.tip_std > 2 * whole.tip_std
    assert gaps.end_std < 2 * whole.end_std


def test_what_is_bright_before_the_needle_is_not_its_end():
    """The tip is looked for at a higher contrast, at which a short bright stretch may win."""
    before = profile(-0.002, 25.0, start=-0.008)
    needle = profile(0.05, 5.0, start=0.012)
    both = replace(before, level=np.maximum(before.level, needle.level))
    extent = find_extent(both, PARAMETERS)
    assert extent.tip > extent.start


def speckle(seed, std=1.8):
    """Return the contrast of tissue in dB, alike over a beam's width."""
    sigma = WIDTH / 2.355 / STEP * np.sqrt(2)
    noise = gaussian_filter1d(np.random.default_rng(seed).normal(size=len(A) + 100), sigma)
    return std * noise[50:-50] / noise.std()


def further(contrast, *, seen=None, end=END, expected=EXPECTED):
    seen = np.ones(len(A), bool) if seen is None else seen
    return faint_part(A, contrast, seen, end, expected, WIDTH)


def test_speckle_alone_is_no_needle():
    found = [further(speckle(seed)) for seed in range(300)]
    assert np.mean([length > 0 for length, _ in found]) <= 0.02
    assert np.mean([continues for _, continues in found]) <= 0.05


def test_a_faint_part_is_followed_to_its_end():
    """Its contrast of 3 dB is as large as that of every other sample of tissue."""
    tip = 0.045
    lengths = np.array([further(speckle(seed) + 3 * (tip > A))[0] for seed in range(300)])
    assert np.mean(lengths > 0) >= 0.9
    error = (END + lengths - tip)[lengths > 0]
    assert abs(np.median(error)) < 1.5e-3
    assert np.sqrt(np.mean(error**2)) < FAINT_STD


def test_a_gap_does_not_show_that_a_needle_ends():
    """After the gap it is faint again, but too short for its end to be sure."""
    contrast = np.where((A < 0.025) | (A > 0.036), 2.6, 0.0)
    assert further(contrast, end=0.025) == (0.0, True)
    assert further(np.zeros(len(A))) == (0.0, False)


def test_a_faint_part_is_followed_to_a_little_beyond_the_expected_tip_at_most():
    bright = np.full(len(A), 5.0)
    assert END + further(bright)[0] == pytest.approx(EXPECTED + 3e-3, abs=2 * STEP)
    assert END + further(bright, seen=A < 0.04)[0] == pytest.approx(0.04, abs=2 * STEP)


def test_only_a_needle_that_is_expected_further_on_has_a_faint_part():
    bright = profile(0.02)
    fading = replace(bright, level=bright.level + 2.6 * ((bright.a > 0.02) & (bright.a < 0.045)))
    short = find_extent(fading, PARAMETERS)
    assert short.tip == pytest.approx(0.02, abs=1.5e-3)
    long = find_extent(fading, PARAMETERS, 0.05)
    assert long.tip == pytest.approx(0.045, abs=1.5e-3)
    assert long.faint == pytest.approx(0.025, abs=2e-3)
    assert long.tip_std == FAINT_STD
    assert long.evidence == short.evidence
    assert not long.continues


def test_an_end_where_it_is_expected_is_the_tip():
    assert further(np.full(len(A), 5.0), expected=END + 2e-3) == (0.0, False)
    assert further(np.full(len(A), 5.0), expected=-np.inf) == (0.0, False)
