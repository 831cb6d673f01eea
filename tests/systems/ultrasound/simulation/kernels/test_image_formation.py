"""Coupling through gel, compression to grey levels and noise."""

import numpy as np
import pytest

from sonoservo.systems.ultrasound.simulation.kernels.image_formation import (
    add_haze,
    compress,
)


def test_grey_levels_are_rounded_to_nearest():
    rng = np.random.default_rng(0)
    level = rng.uniform(-40, 60, (20, 500))
    iq = (10 ** (level / 20) * np.exp(2j * np.pi * rng.random(level.shape))).astype(np.complex64)
    grey = np.empty(level.shape, np.uint8)
    silent, offsets = np.zeros(500, np.float32), np.full(500, 89.25, np.float32)
    compress(grey, iq, np.ones(20, np.float32), silent, np.uint64(0), 4.25, offsets)
    exact = 4.25 * 20 * np.log10(np.abs(iq.astype(complex))) + 89.25
    clear = np.abs(exact - np.floor(exact) - 0.5) > 0.01
    assert clear.mean() > 0.9
    assert (grey[clear] == np.clip(np.rint(exact[clear]), 0, 255)).all()


def test_noise_is_rayleigh_and_repeatable():
    """Logarithm of a Rayleigh amplitude: mean -2.51 dB, standard deviation 5.57 dB."""

    def noise(key):
        grey = np.empty((100, 400), np.uint8)
        silent, gains = np.zeros(grey.shape, np.complex64), np.ones(100, np.float32)
        loud, offsets = np.ones(400, np.float32), np.full(400, 150, np.float32)
        compress(grey, silent, gains, loud, np.uint64(key), 4.0, offsets)
        return grey.astype(float)

    first = noise(1)
    assert (first.mean() - 150) / 4 == pytest.approx(-2.51, abs=0.2)
    assert first.std() / 4 == pytest.approx(5.57, abs=0.2)
    assert (first == noise(1)).all()
    assert abs(np.corrcoef(first.ravel(), noise(2).ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(first[1:].ravel(), first[:-1].ravel())[0, 1]) < 0.02


def test_tissue_at_rest_changes_as_stated():
    """Correlation of the echoes at two times: 1 - e (1 - cos(t / tau)); the intensity stays."""
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(2, 2, 90, 500)).astype(np.float32) / np.sqrt(2)
    tissue, field = (draws[:, 0] + 1j * draws[:, 1]).astype(np.complex64)
    share, silent = 0.3, np.zeros(1000, np.float32)

    def at(turn):
        iq = tissue.copy()
        changing = np.sqrt(share) * np.exp(1j * turn)
        add_haze(iq, field, silent, changing, np.sqrt(1 - share))
        return iq

    for turn in (0.5, 1.5, np.pi):
        one, other = at(0.2), at(0.2 + turn)
        correlation = np.vdot(one, other).real / np.vdot(one, one).real
        assert correlation == pytest.approx(1 - share * (1 - np.cos(turn)), abs=0.02)
        assert np.vdot(other, other).real / other.size == pytest.approx(1, abs=0.03)
