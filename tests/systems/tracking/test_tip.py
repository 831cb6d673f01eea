from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.special import ndtr
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals import AxisProfile, PointSpread
from sonoservo.systems.tracking import TipParameters
from sonoservo.systems.tracking.axis import axis_through
from sonoservo.systems.tracking.candidates import select_candidates
from sonoservo.systems.tracking.tip import axis_profile, find_extent, most_evident_stretch

SIGMA = 0.8e-3
PARAMETERS = TipParameters(beam_width=SIGMA * np.sqrt(8 * np.log(2)))
STEP = 0.25e-3
SCENE_VOLUME = Scene(seed=2).volume(0)


def profile(tip, level=12.0, gaps=(), start=0.0, sigma=SIGMA, seen=0.08):
    """Contrast of a needle over a background of 20 dB, blurred at its ends, with gaps."""
    a = np.arange(-0.01, 0.08, STEP)
    amplitude = ndtr((a - start) / sigma) - ndtr((a - tip) / sigma)
    shaft = 20 * np.log10(10 ** (level / 20) * amplitude + 1)
    for begin, end in gaps:
        shaft[(a > begin) & (a < end)] = 0
    return AxisProfile(a, np.outer(a, [1, 0, 0]), 20 + shaft, np.full(len(a), 20.0), a < seen)


@pytest.mark.parametrize("tip", [0.008, 0.05])
def test_the_blurred_end_of_a_mirror_is_the_tip(tip):
    extent = find_extent(profile(tip, 30.0), PARAMETERS)
    assert extent.tip == pytest.approx(tip, abs=0.6e-3)
    assert extent.tip_std < SIGMA
    assert extent.seen > 0.95
    assert not extent.leaves


def test_a_rough_end_may_be_that_of_shaft_or_bevel():
    rough, mirror = (find_extent(profile(0.03, level), PARAMETERS) for level in (10.0, 34.0))
    assert rough.tip == pytest.approx(0.03, abs=0.8e-3)
    assert rough.bevel_std == pytest.approx(PARAMETERS.bevel_length / np.sqrt(3))
    assert mirror.bevel_std < 0.2e-3


@pytest.mark.parametrize(
    ("level", "incidence_deg", "hidden"), [(16.0, 35.0, 0.5), (16.0, 5.0, 0.0), (4.0, 35.0, 0.0)]
)
def test_the_bevel_of_a_needle_too_bright_to_be_smooth_is_hidden(level, incidence_deg, hidden):
    seen, incidence = profile(0.03, level), np.deg2rad(incidence_deg)
    seen = replace(seen, incidence=np.full(len(seen.a), incidence), white=60.0)
    extent, length = find_extent(seen, PARAMETERS), PARAMETERS.bevel_length
    # Any part is hidden as probably; half of the echogenic needles are so to the point.
    assert extent.bevel == pytest.approx(hidden * length / 2, abs=0.06 * length)
    assert extent.bevel**2 + extent.bevel_std**2 == pytest.approx(length**2 / 3, rel=0.15)


@pytest.mark.parametrize(("elsewhere", "hidden"), [(-4.0, True), (14.0, False)])
def test_where_the_shaft_mirrors_sound_a_bevel_as_faint_as_the_needle_elsewhere_is_hidden(
    elsewhere, hidden
):
    glint = profile(0.05, 30.0, start=0.043)
    seen = replace(glint, level=np.maximum(glint.level, profile(0.05, elsewhere).level))
    incidence = np.where(seen.a < 0.043, np.deg2rad(30), np.deg2rad(3))
    extent = find_extent(replace(seen, incidence=incidence, white=80.0), PARAMETERS)
    assert extent.tip == pytest.approx(0.05, abs=1e-3)
    assert (extent.bevel > 0.2 * PARAMETERS.bevel_length) == hidden
    assert (extent.bevel < 0.1 * PARAMETERS.bevel_length) == (not hidden)
    assert (extent.bevel_std > 0.5e-3) == hidden


@pytest.mark.parametrize("ahead", [8e-3, 12e-3, 20e-3])
@pytest.mark.parametrize("level", [12.0, 30.0])
def test_what_shines_ahead_of_the_tip_is_not_its_end(level, ahead):
    needle = profile(0.03, level)
    spot = 40.0 * np.exp(-0.5 * ((needle.a - 0.03 - ahead) / 1.2e-3) ** 2)
    extent = find_extent(replace(needle, level=np.maximum(needle.level, 20 + spot)), PARAMETERS)
    assert extent.tip == pytest.approx(0.03, abs=1e-3)


def test_what_shines_close_ahead_may_be_the_end():
    needle = profile(0.03)
    spot = 40.0 * np.exp(-0.5 * ((needle.a - 0.036) / 1.2e-3) ** 2)
    extent = find_extent(replace(needle, level=np.maximum(needle.level, 20 + spot)), PARAMETERS)
    assert 3e-3 < extent.tip_std < 6e-3
    assert abs(extent.tip - 0.03) < 2 * extent.tip_std


@pytest.mark.parametrize("gap", [5e-3, 15e-3])
def test_a_needle_that_hides_shows_again_as_bright_as_before(gap):
    extent = find_extent(profile(0.06, 20.0, gaps=[(0.03, 0.03 + gap)]), PARAMETERS)
    assert extent.tip == pytest.approx(0.06, abs=1e-3)


@pytest.mark.parametrize("length", [8e-3, 20e-3])
def test_a_part_that_is_much_brighter_is_still_the_needle(length):
    faint, bright = profile(0.045 - length, 5.0), profile(0.05, 30.0, start=0.05 - length)
    both = replace(faint, level=np.maximum(faint.level, bright.level))
    assert find_extent(both, PARAMETERS).tip == pytest.approx(0.05, abs=1e-3)


def test_nothing_stands_out():
    assert not find_extent(profile(0.03, level=-40.0), PARAMETERS)


def test_needle_that_leaves_the_field_of_view():
    assert find_extent(profile(0.09, seen=0.05), PARAMETERS).leaves
    assert find_extent(profile(0.09), PARAMETERS).leaves


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


def test_profile_follows_the_axis_in_any_pose():
    X_WP = RigidTransform(RollPitchYaw(2.0, 0.3, -0.5), [0.4, 0.1, 0.2])
    inside = entry_on_side() + np.array([8e-3, 4e-3, 0])
    ends = X_WP.multiply(np.array([inside, inside + np.array([0.025, 0.006, 0])]).T).T
    volume = Scene(seed=3, spacing=1.0e-3).volume(0, lambda time: ends, X_WP)
    axis = axis_through(np.linspace(*ends, 3))
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
    options = {"radius": 6e-3, "cross_section": 4e-6, "slab": 2e-3}
    found = select_candidates(volume, axis, start=0, stop=length, **options)
    a = axis.abscissa(found.p_P)
    counts = np.histogram(a, np.linspace(0, length, 6))[0]
    # As many where the needle is faint as where it is 20 dB brighter.
    assert counts.min() > 0.5 * counts.max()
    assert np.mean(axis.distance(found.p_P) < 2e-3) > 0.8
    assert axis.distance(found.p_P).max() <= 6e-3 + 1e-9
    assert found.weights.min() >= 0
    assert found.weights.max() <= 1
    outside = axis_through(ends + 1.0)
    assert len(select_candidates(volume, outside, start=0, stop=0.02, **options).p_P) == 0


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


@pytest.mark.parametrize("sigma", [0.5e-3, 1.2e-3])
def test_a_known_blur_is_undone_whatever_the_parameter_says(sigma):
    blurred = profile(0.03, 30.0, sigma=sigma)
    width = np.full(len(blurred.a), sigma * np.sqrt(8 * np.log(2)))
    extent = find_extent(replace(blurred, beam_width=width), TipParameters(beam_width=9e-3))
    assert extent.tip == pytest.approx(0.03, abs=0.7 * sigma)


def test_stated_deviations_hold_the_tips_of_needles_that_fade_at_random():
    """Drawn from the model itself: levels that wander, speckle, and a blurred rough end."""
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(100):
        tip = rng.uniform(0.02, 0.06)
        sharp = profile(tip, 12.0)
        grain = gaussian_filter1d(rng.normal(size=len(sharp.a)), SIGMA * np.sqrt(2) / STEP)
        wander = gaussian_filter1d(rng.normal(size=len(sharp.a)), 8e-3 / STEP)
        level = (sharp.level - 20) * (1 + 0.3 * wander / wander.std()).clip(0, 2)
        line = replace(sharp, level=20 + level + 1.8 * grain / grain.std())
        extent = find_extent(line, PARAMETERS)
        inside.append(abs(extent.tip - tip) < 1.96 * extent.tip_std)
    assert np.mean(inside) >= 0.85


def test_what_is_bright_before_the_needle_is_not_its_end():
    before = profile(-0.002, 25.0, start=-0.008)
    needle = profile(0.05, 5.0, start=0.012)
    both = replace(before, level=np.maximum(before.level, needle.level))
    extent = find_extent(both, PARAMETERS)
    assert extent.tip > extent.start


def looked_at(needle, contrast, looks=8.0):
    """A profile with the tissue that was seen there before the needle came."""
    return replace(needle, before=contrast, looks=np.full(len(needle.a), looks))


@pytest.mark.parametrize("ahead", [4e-3, 6e-3, 12e-3])
@pytest.mark.parametrize("bright", [15.0, 40.0])
def test_what_was_there_before_the_needle_came_is_not_its_end(ahead, bright):
    needle = profile(0.03)
    spot = bright * np.exp(-0.5 * ((needle.a - 0.03 - ahead) / 1.2e-3) ** 2)
    needle = replace(needle, level=np.maximum(needle.level, 20 + spot))
    seen = spot + np.random.default_rng(0).normal(scale=1.0, size=len(spot))
    extent = find_extent(looked_at(needle, seen), PARAMETERS)
    assert extent.tip == pytest.approx(0.03, abs=1e-3)
    assert extent.tip_std < 2e-3
    assert extent.seen > 0.99


def test_what_shines_where_nothing_was_is_the_needle():
    needle = profile(0.05, gaps=[(0.02, 0.042)])
    assert find_extent(needle, PARAMETERS).tip < 0.021
    extent = find_extent(looked_at(needle, np.zeros(len(needle.a))), PARAMETERS)
    assert extent.tip == pytest.approx(0.05, abs=1e-3)


def test_only_places_that_the_tip_has_surely_not_reached_are_a_record_of_the_tissue():
    extent = find_extent(profile(0.03), PARAMETERS)
    a = profile(0.03).a
    assert not extent.ahead[a < 0.03 + 3 * SIGMA].any()
    assert extent.ahead[(a > 0.03 + 6 * SIGMA) & (a < 0.08)].all()
    assert not extent.ahead[a >= 0.08].any()  # not seen


def test_a_record_of_tissue_that_has_moved_since_is_not_believed():
    moved = []
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=(2, len(profile(0.03).a)))
        speckle, other = 1.9 * np.sqrt(8) * uniform_filter1d(noise, 8)
        needle = replace(profile(0.03), level=profile(0.03).level + speckle)
        assert find_extent(looked_at(needle, speckle), PARAMETERS).as_before > 0.99
        extent = find_extent(looked_at(needle, other), PARAMETERS)
        assert extent.tip == pytest.approx(0.03, abs=1e-3)
        moved.append(extent.as_before)
    assert np.median(moved) < 0.1
