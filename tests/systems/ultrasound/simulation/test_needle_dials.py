"""How a needle's echo varies along it, in time, with the angle and with its tip's roll."""

import numpy as np
import pytest
from renderers import DEEP, make_renderer, still

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.ultrasound.simulation.needle_echo import NeedleEchoParameters, NeedleFading

TIP = np.array([0.0, 0.0, -0.15])
SILENT = {"tip_db": -60.0, "shadow": 0.0}


def needle(dip_deg, roll=0.0, length=0.04):
    dip = np.deg2rad(dip_deg)
    along = np.array([np.cos(dip), 0, -np.sin(dip)])
    return Needle(np.array([TIP - length * along, TIP]), 0.635e-3, roll=roll)


def echo(parameters, held, time=0.0):
    """Echo of the needle alone in the middle frame, (lines, samples)."""
    renderer = make_renderer(DEEP, NeedleEchoParameters(**parameters))
    X, times = still(renderer), np.full(27, time)
    with_it = renderer.echo(X, [held] * 27, 1, times)[13]
    return with_it - renderer.tissue_echo(X, 1)[13]


def peak_db(iq):
    return 20 * np.log10(np.abs(iq).max() + 1e-9)


def test_steep_needle_fades_down_to_nothing():
    levels = {
        lobe: [
            peak_db(echo(SILENT | {"diffuse_lobe_deg": lobe}, needle(dip))) for dip in (20, 40, 60)
        ]
        for lobe in (None, 15.0)
    }
    assert np.ptp(levels[None][1:]) < 3  # a rough needle shows at any angle
    # Amplitude 2^-(a / 15 deg)^2. Lines fan out, so that a needle has its best angle somewhere.
    assert levels[15.0][0] - levels[15.0][2] > 20
    assert levels[15.0][2] < 8  # the ends of a smooth rod still diffract


def test_dimples_show_a_steep_needle():
    smooth = echo(SILENT | {"diffuse_lobe_deg": 10.0}, needle(60))
    dimpled = echo(SILENT | {"diffuse_lobe_deg": 10.0, "dimples_db": 26.0}, needle(60))
    assert peak_db(smooth) < 8
    assert 22 < peak_db(dimpled) < 36


def test_bevel_is_bright_where_its_face_looks_at_the_probe():
    shaft = {"specular_db": -60.0, "shadow": 0.0, "tip_db": 30.0}
    plain = peak_db(echo(shaft, needle(10)))
    by_roll = {
        roll: peak_db(echo(shaft | {"tip": "bevel"}, needle(10, np.deg2rad(roll))))
        for roll in (0, 60, 120, 180)
    }
    # cos^2 of the angle between face and sound: 10 + 20 deg when the face looks up.
    expected = 40 * np.log10(np.cos(np.deg2rad(30)))
    assert by_roll[0] - plain == pytest.approx(expected, abs=0.7)
    assert by_roll[0] > by_roll[60] > by_roll[120] - 1e-3
    assert by_roll[180] - plain == pytest.approx(-15, abs=0.5)


def test_turning_the_needle_is_turning_its_tip():
    shaft = {"tip": "bevel", "shadow": 0.0}
    rolled = echo(shaft, needle(10, np.pi / 3))
    turned = echo(shaft | {"tip_roll_deg": 60.0}, needle(10))
    np.testing.assert_allclose(rolled, turned, atol=1e-4)


def test_diamond_depends_less_on_roll_than_a_bevel_and_blunt_not_at_all():
    shaft = {"specular_db": -60.0, "shadow": 0.0}
    rolls = np.deg2rad([0, 30, 60, 90])
    diamond = [peak_db(echo(shaft | {"tip": "diamond"}, needle(10, roll))) for roll in rolls]
    blunt = [peak_db(echo(shaft | {"tip": "blunt"}, needle(10, roll))) for roll in rolls]
    assert np.ptp(diamond) < 12
    assert np.ptp(blunt) < 1e-3
    assert max(blunt) < min(diamond) + 12


def test_fading_has_its_strength_its_length_and_its_period():
    parameters = NeedleEchoParameters(fading_db=5.0, fading_length=0.02, fading_period=3.0)
    places, times = np.arange(0, 0.1, 1e-3), np.arange(0, 30, 0.5)
    fields = [NeedleFading(parameters, np.random.default_rng(seed)) for seed in range(60)]
    levels = np.array([[f.level_db(places, time) for time in times] for f in fields])
    assert levels.std() == pytest.approx(5, rel=0.1)

    def correlation(a, b):
        return (a * b).mean() / levels.var()

    # A Gaussian of one length, or one period: exp(-1/2).
    assert correlation(levels[..., :-20], levels[..., 20:]) == pytest.approx(0.607, abs=0.1)
    assert correlation(levels[:, :-6], levels[:, 6:]) == pytest.approx(0.607, abs=0.1)


def test_faded_needle_changes_in_time_and_an_unfaded_one_does_not():
    for fading, same in ((0.0, True), (6.0, False)):
        dials = SILENT | {"fading_db": fading}
        echoes = [echo(dials, needle(0), time) for time in (0.0, 5.0)]
        assert np.array_equal(*echoes) == same


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fading_db", -1.0),
        ("fading_length", 0.0),
        ("diffuse_lobe_deg", 0.0),
        ("dimples_db", 90.0),
        ("tip", "round"),
    ],
)
def test_dial_out_of_range_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        NeedleEchoParameters(**{field: value})
