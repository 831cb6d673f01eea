"""Radio-frequency lines against the signal that they are."""

import numpy as np
import pytest
from renderers import DOWN, NOWHERE, make_renderer, shift, still
from scipy.signal import hilbert

from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import load_transducer


@pytest.fixture(scope="module")
def renderer():
    return make_renderer(
        Tissue(size=[0.2, 0.2, 0.2]), transducer=load_transducer("zhao2012"),
        transmit_frequency=7.5e6, focus_depth=0.05, sector=0.3, frame_pitch_deg=0.7547, frames=5,
        sample_pitch=1540 / 2 / 27e6, depth=0.05, volume_rate=1.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def X_TP(renderer):
    return still(renderer, shift(0, 0, 0.08) @ DOWN)


def test_envelope_and_phase_are_those_of_the_complex_echo(renderer, X_TP):
    needles = [NOWHERE] * renderer.geometry.frames
    lines = renderer.radio_frequency_lines(X_TP, needles, 1)
    echo = renderer.echo(X_TP, needles, 1)
    inside = slice(200, -200)  # Hilbert's transform rings at the ends
    analytic = hilbert(lines.astype(float), axis=-1)[..., inside]
    error = np.abs(np.abs(analytic) - np.abs(echo[..., inside]))
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(np.abs(echo) ** 2))


def test_spectrum_lies_at_the_transmitted_frequency(renderer, X_TP):
    lines = renderer.radio_frequency_lines(X_TP, [NOWHERE] * renderer.geometry.frames, 1)
    power = np.mean(np.abs(np.fft.rfft(lines, axis=-1)) ** 2, axis=(0, 1))
    frequency = np.fft.rfftfreq(lines.shape[-1], 1 / 27e6)
    assert np.average(frequency, weights=power) == pytest.approx(7.5e6, rel=0.02)
    assert power[frequency < 2e6].sum() < 1e-3 * power.sum()


def test_samples_too_far_apart_for_the_carrier_are_refused():
    coarse = make_renderer()
    with pytest.raises(ValueError, match="sample_pitch: .* below a quarter"):
        coarse.radio_frequency_lines(still(coarse), [NOWHERE] * coarse.geometry.frames, 1)
