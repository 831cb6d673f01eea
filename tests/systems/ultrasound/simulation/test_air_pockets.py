"""Air pockets under the face: their share, their size and duration, and what they hide."""

import numpy as np
import pytest
from renderers import DOWN, NOWHERE, make_renderer, shift, still

from sonoservo.systems.ultrasound import ImagingParameters, load_transducer, sweep_geometry
from sonoservo.systems.ultrasound.simulation import AirPocketParameters
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPockets

PROBE = load_transducer("4dc7_3_40")
IMAGING = ImagingParameters()
GEOMETRY = sweep_geometry(PROBE, IMAGING)
TIMES = GEOMETRY.frame_period * np.arange(GEOMETRY.frames)


def pockets(seed=0, **parameters):
    rng = np.random.default_rng(seed)
    return AirPockets(AirPocketParameters(**parameters), PROBE, IMAGING, GEOMETRY, rng)


def test_air_lies_under_the_stated_share_of_the_face():
    shares = [pockets(seed, share=0.2, size=3e-3).air(TIMES).mean() for seed in range(40)]
    assert np.mean(shares) == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize("apart", ["in place", "in time"])
def test_air_reaches_as_far_and_lasts_as_long_as_stated(apart):
    """Two Gaussians with correlation r differ in sign with 1/2 - arcsin(r) / pi (Sheppard 1899)."""
    unlike = []
    for seed in range(150):
        drawn = pockets(seed, share=0.5, size=20 * PROBE.element_pitch, period=3.0)
        now = drawn.air(np.zeros(GEOMETRY.frames))
        if apart == "in place":
            unlike.append((now[..., 20:] ^ now[..., :-20]).mean())
        else:
            unlike.append((now ^ drawn.air(np.full(GEOMETRY.frames, 3.0))).mean())
    expected = 0.5 - np.arcsin(np.exp(-0.5)) / np.pi
    assert np.mean(unlike) == pytest.approx(expected, abs=0.02)


def test_a_group_of_frames_sees_the_air_of_the_whole_sweep():
    drawn = pockets(share=0.3)
    part = slice(4, 8)
    np.testing.assert_array_equal(drawn.air(TIMES[part], part), drawn.air(TIMES)[part])
    together = drawn.open_shares(TIMES)
    np.testing.assert_array_equal(drawn.open_shares(TIMES[part], part), together[part])


def test_half_an_aperture_sends_and_receives_half_of_the_amplitude(monkeypatch):
    """A quarter is left of an echo from the focus, and nothing where the whole aperture is shut."""
    drawn = pockets(share=0.5)
    shut = np.zeros((GEOMETRY.frames, 7, PROBE.elements), bool)
    shut[..., PROBE.elements // 2 :] = True
    monkeypatch.setattr(drawn, "air", lambda times, part: shut)
    share = drawn.open_shares(TIMES)[0]
    middle = GEOMETRY.lines / 2 - 0.5
    at_edge = np.interp(middle, np.arange(GEOMETRY.lines), share)
    assert at_edge == pytest.approx(0.25, abs=0.02)
    half_aperture = IMAGING.focus_depth / PROBE.transmit_f_number / 2 / PROBE.element_pitch
    lines = np.arange(GEOMETRY.lines) - middle
    assert (share[lines < -half_aperture - 1] == 1).all()
    assert (share[lines > half_aperture + 1] == 0).all()
    # Across the height of the elements, the shut part counts alike.
    shut[:], shut[:, :4] = False, True
    np.testing.assert_allclose(drawn.open_shares(TIMES), (3 / 7) ** 2, rtol=1e-5)


def test_an_air_pocket_hides_what_lies_below_it_and_nothing_else():
    renderer = make_renderer(frames=3, volume_rate=20.0)
    poses, needles = still(renderer), [NOWHERE] * 3
    clean = renderer.render(poses, needles, 1, 0)
    np.testing.assert_array_equal(renderer._renderer._air.open_shares(np.zeros(3)), 1)
    renderer._renderer._air.open_shares = lambda times, part: (
        np.repeat([[0.0, 1.0]], 3, axis=0)
        .repeat(renderer.geometry.lines // 2, axis=1)
        .astype(np.float32)
    )
    shadowed = renderer.render(poses, needles, 1, 0)
    half = renderer.geometry.lines // 2
    np.testing.assert_array_equal(shadowed[:, half:], clean[:, half:])
    # In the air above the tissue, there is only noise.
    lifted = renderer.render(still(renderer, shift(0, 0, 1) @ DOWN), needles, 1, 0)
    np.testing.assert_array_equal(shadowed[:, :half], lifted[:, :half])
