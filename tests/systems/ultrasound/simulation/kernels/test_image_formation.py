"""Coupling through gel, compression to grey levels and noise."""

import numpy as np
import pytest

from sonoservo.systems.ultrasound.simulation.kernels.image_formation import compress, coupling


def test_coupling_measures_the_way_along_the_line():
    box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.0]])
    origins = np.array([[0, 0, 0.002], [0, 0, 0.002], [0, 0, -0.01], [0.2, 0, 0.002]])
    slanted = np.array([np.sqrt(0.75), 0, -0.5])  # twice as far: 4 mm
    down = np.array([0, 0, -1.0])
    share = coupling(np.eye(4)[:3], origins, np.array([down, slanted, down, down]), box, 3e-3)
    assert share.tolist() == [1, 0, 1, 0]


def test_grey_levels_are_rounded_to_nearest():
    rng = np.random.default_rng(0)
    level = rng.uniform(-40, 60, (20, 500))
    iq = (10 ** (level / 20) * np.exp(2j * np.pi * rng.random(level.shape))).astype(np.complex64)
    grey = np.empty(level.shape, np.uint8)
    silent = np.zeros(500, np.float32)
    compress(grey, iq, np.ones(20, np.float32), silent, np.uint64(0), 4.25, 89.25)
    exact = 4.25 * 20 * np.log10(np.abs(iq.astype(complex))) + 89.25
    clear = np.abs(exact - np.floor(exact) - 0.5) > 0.01
    assert clear.mean() > 0.9
    assert (grey[clear] == np.clip(np.rint(exact[clear]), 0, 255)).all()


def test_noise_is_rayleigh_and_repeatable():
    """Logarithm of a Rayleigh amplitude: mean -2.51 dB, standard deviation 5.57 dB."""

    def noise(key):
        grey = np.empty((100, 400), np.uint8)
        compress(
            grey,
            np.zeros(grey.shape, np.complex64),
            np.ones(100, np.float32),
            np.ones(400, np.float32),
            np.uint64(key),
            4.0,
            150.0,
        )
        return grey.astype(float)

    first = noise(1)
    assert (first.mean() - 150) / 4 == pytest.approx(-2.51, abs=0.2)
    assert first.std() / 4 == pytest.approx(5.57, abs=0.2)
    assert (first == noise(1)).all()
    assert abs(np.corrcoef(first.ravel(), noise(2).ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(first[1:].ravel(), first[:-1].ravel())[0, 1]) < 0.02
