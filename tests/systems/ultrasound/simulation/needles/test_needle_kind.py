"""How a needle's echo varies along it, in time, with the angle and with its tip's roll."""

import dataclasses

import numpy as np
import pytest
from renderers import DEEP, make_renderer, still

from sonoservo.diagrams import load_scenario
from sonoservo.systems.signals import Needle
from sonoservo.systems.ultrasound.simulation import NeedleEchoParameters, load_needle
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleFading
from sonoservo.systems.ultrasound.simulation.needles.needle_kind import draw_needle

TIP = np.array([0.0, 0.0, -0.15])
SILENT = {"shadow": 0.0}


def needle(dip_deg, roll=0.0, length=0.04):
    dip = np.deg2rad(dip_deg)
    along = np.array([np.cos(dip), 0, -np.sin(dip)])
    return Needle(np.array([TIP - length * along, TIP]), 0.635e-3, roll=roll)


def echo(parameters, held, time=0.0, **imaging):
    """Echo of the needle alone in the middle frame, (lines, samples)."""
    renderer = make_renderer(DEEP, NeedleEchoParameters(**parameters), **imaging)
    X, times = still(renderer), np.full(27, time)
    with_it = renderer.echo(X, [held] * 27, 1, times)[13]
    return with_it - renderer.tissue_echo(X, 1)[13]


def peak_db(iq):
    return 20 * np.log10(np.abs(iq).max() + 1e-9)


# Nichols et al. (2003): grey above the background, 15 deg between needle and beam, relative to
# that at perpendicular incidence (68, the middle of 60 to 76, where all needles were alike).
NICHOLS = {"echogenic": 40 / 68, "coated": 9 / 68, "biopsy": 5 / 68}
WHITE_DB = 0.58 * 50 + 9
"""From the tissue's grey to white, at the gain and the dynamic range of the default settings."""


def contrast_db(kind, dip_deg, places=12):
    """Mean intensity over the tissue's of the middle of a needle, in dB."""
    powers = []
    renderer = make_renderer(
        DEEP, dataclasses.replace(load_needle(kind).echo, **SILENT), sector=0.1
    )
    X, middle = still(renderer), renderer.geometry.lines // 2
    tissue = renderer.tissue_echo(X, 1)[13]
    for place in range(places):
        held = needle(dip_deg, length=0.03 + 1.1e-3 * place)
        centred = Needle(held.shaft - held.shaft.mean(axis=0) + TIP, held.radius)
        with_it = renderer.echo(X, [centred] * 27, 1)[13]
        powers.append(np.abs(with_it - tissue)[middle - 2 : middle + 3].max(axis=1) ** 2)
    return 10 * np.log10(np.mean(powers))


def test_needles_show_by_angle_as_published():
    """Alike across the beam; along it, dimples stay, a coat helps and steel vanishes."""
    kinds = ("echogenic", "coated", "biopsy")
    across = [contrast_db(kind, 0, 1) for kind in kinds]
    assert np.ptp(across) < 3
    assert min(across) > 35
    steep = [contrast_db(kind, 75) for kind in kinds]
    assert steep[0] > steep[1] + 3 > steep[2] + 6
    # Tissue and needle together, in the share of the way from the tissue's grey to white.
    shown = 10 * np.log10(1 + 10 ** (np.array(steep) / 10))
    assert shown == pytest.approx(WHITE_DB * np.array([NICHOLS[kind] for kind in kinds]), abs=4)
    assert 5 < contrast_db("biopsy", 30) < 14  # it sinks into the tissue from there on


def test_thin_needles_are_fainter():
    """Intensity as the radius, at any angle: a cylinder's."""
    solid = SILENT | {"reverberation_db": -200.0}
    fine = {"sample_pitch": 0.05e-3, "sector": 0.1}
    shaft = np.add(needle(0).shaft, [0.02, 0, 0])
    thick, thin = (
        peak_db(echo(solid, Needle(shaft, radius), **fine)) for radius in (0.635e-3, 0.635e-3 / 4)
    )
    assert thick - thin == pytest.approx(10 * np.log10(4), abs=0.7)


def test_turning_the_needle_is_turning_its_tip():
    rolled = echo(SILENT, needle(10, np.pi / 3))
    turned = echo(SILENT | {"tip_roll_deg": 60.0}, needle(10))
    np.testing.assert_allclose(rolled, turned, atol=1e-4)


def test_diamond_depends_less_on_roll_than_a_bevel_and_blunt_not_at_all():
    rolls = np.deg2rad([0, 60, 120, 180])
    spread = {
        tip: np.ptp([peak_db(tip_of(tip, roll)) for roll in rolls])
        for tip in ("blunt", "diamond", "bevel")
    }
    assert spread["blunt"] < 0.5
    assert spread["diamond"] < spread["bevel"]


def tip_of(tip, roll):
    """Echo around the tip of a smooth needle that dips by 20 deg."""
    return echo(SILENT | {"diffuse_db": -100.0, "tip": tip}, needle(20, roll))[38:60]


def test_fading_has_its_strength_its_length_and_its_period():
    parameters = NeedleEchoParameters(fading_db=5.0, fading_length=0.02, fading_period=3.0)
    places, times = np.arange(0, 0.1, 1e-3), np.arange(0, 30, 0.5)
    fields = [NeedleFading(parameters, np.random.default_rng(seed)) for seed in range(60)]
    levels = np.array([f.level_db(places, times) for f in fields])
    assert levels.std() == pytest.approx(5, rel=0.1)

    def correlation(a, b):
        return (a * b).mean() / levels.var()

    # A Gaussian of one length, or one period: exp(-1/2).
    assert correlation(levels[..., :-20], levels[..., 20:]) == pytest.approx(0.607, abs=0.1)
    assert correlation(levels[:, :-6], levels[:, 6:]) == pytest.approx(0.607, abs=0.1)


def test_a_withdrawn_needle_leaves_a_track_of_its_level():
    """Rough, so the same at any angle, and without a shadow; 20 dB here, to stand out."""
    powers = []
    for dip in (0, 30):
        renderer = make_renderer(DEEP, NeedleEchoParameters(**SILENT), sector=0.3, track_db=20.0)
        ends = needle(dip).shaft
        out = Needle(np.zeros((0, 3)), 0.635e-3, track=ends - ends.mean(axis=0) + TIP)
        X, middle = still(renderer), renderer.geometry.lines // 2
        left = renderer.echo(X, [out] * 27, 1)[13] - renderer.tissue_echo(X, 1)[13]
        powers.append((np.abs(left[middle - 8 : middle + 9]).max(axis=1) ** 2).mean())
    assert 10 * np.log10(powers) == pytest.approx(20, abs=5)


def test_a_seed_draws_the_needle_and_held_out_seeds_draw_other_kinds():
    drawn = {seed: draw_needle(seed) for seed in (*range(40), *range(100, 140))}
    assert drawn[7] == draw_needle(7)
    tips = {True: set(), False: set()}
    for seed, each in drawn.items():
        tips[seed < 100].add(each["scanner"]["needle"]["tip"])
    assert tips == {True: {"bevel", "diamond"}, False: {"bevel"}}
    assert {each["hand"]["gauge"] for each in drawn.values()} == {18, 20, 22}
    clutter = [each["scanner"]["clutter_db"] for each in drawn.values()]
    assert -30 <= min(clutter) < -25 < -15 < max(clutter) <= -10
    again = load_scenario(load_scenario("clinic", seed=101), seed=3)
    assert again.scanner.needle == load_scenario("clinic", seed=3).scanner.needle
    assert load_scenario("clinic", seed=3, changes={"hand.gauge": 17}).hand.gauge == 17
