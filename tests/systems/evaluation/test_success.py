import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.evaluation.success import conspicuous_length
from sonoservo.systems.signals import Volume

DB = 0.25
"""Decibels of a grey level of these volumes."""


def volume_with_line(start, stop, contrast_db, *, factor=1.0, speckle_db=0.0, lit=1.0):
    """Volume of 50 x 60 x 50 mm whose tissue is at 25 dB, with a line 1.6 mm thick.

    The line lies at `factor` times its depth, and stands out over the share `lit` of its length.
    """
    spacing = 0.5e-3
    grid = np.moveaxis(np.indices((101, 121, 101)), 0, -1) * spacing + [-0.025, 0, -0.025]
    start, stop = np.array(start) * [1, factor, 1], np.array(stop) * [1, factor, 1]
    k, length = (stop - start) / np.linalg.norm(stop - start), np.linalg.norm(stop - start)
    along = (grid - start) @ k
    aside = np.linalg.norm(grid - start - along[..., np.newaxis] * k, axis=-1)
    bright = (along >= 0) & (along <= lit * length) & (aside <= 1.6e-3)
    level = (
        25 + contrast_db * bright + speckle_db * np.random.default_rng(7).normal(size=bright.shape)
    )
    return Volume(
        (level / DB).clip(0, 255).astype(np.float32),
        origin=np.array([-0.025, 0, -0.025]),
        spacing=np.full(3, spacing),
        time=0.0,
        X_WP=RigidTransform(),
        decibels_per_level=DB,
    )


START, STOP = (-0.012, 0.015, -0.01), (0.012, 0.047, 0.01)


@pytest.mark.parametrize("lit", [0.25, 1.0])
def test_what_stands_out_is_measured(lit):
    points = np.linspace(START, STOP, 9)
    length = lit * np.linalg.norm(np.subtract(STOP, START))
    volume = volume_with_line(START, STOP, 12.0, lit=lit)
    assert conspicuous_length(volume, points) == pytest.approx(length, abs=1.5e-3)


def test_what_does_not_stand_out_by_six_decibels_or_is_outside_is_not_seen():
    points = np.linspace(START, STOP, 9)
    assert conspicuous_length(volume_with_line(START, STOP, 5.0), points) == 0
    assert conspicuous_length(volume_with_line(START, STOP, 7.0), points) > 0.035
    speckle = volume_with_line(START, STOP, 0.0, speckle_db=5.6)
    assert conspicuous_length(speckle, points) < 1e-3
    assert conspicuous_length(speckle, points + np.array([0.1, 0, 0])) == 0
    assert conspicuous_length(speckle, np.array([START, START])) == 0


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_wrong_speed_of_sound_does_not_hide_a_needle(factor):
    volume = volume_with_line(START, STOP, 12.0, factor=factor)
    assert conspicuous_length(volume, np.linspace(START, STOP, 9)) > 0.038
