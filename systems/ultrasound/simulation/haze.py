"""Clutter, slow change at rest, and errors of the gain, which a console adds to the echoes."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam

_SLIDERS = 8
"""Number of sliders with which a person sets the time-gain compensation."""


def speckle_field(
    geometry: SweepGeometry, beam: Beam, rng: np.random.Generator
) -> NDArray[np.complex64]:
    """Return (frames, lines, samples) speckle of mean intensity 1 that belongs to the probe.

    It has the beam's width at half depth; shifted around by a third of the lines, it is
    independent.
    """
    middle = geometry.samples // 2
    depth = geometry.sample_pitch * middle
    frame = geometry.frame_pitch * (geometry.motor_radius + depth)
    line = geometry.line_pitch * (geometry.array_radius + depth)
    field = rng.standard_normal((2, *geometry.shape), dtype=np.float32)
    widths = (beam.elevation[middle] / frame, beam.lateral[middle] / line)
    for axis, sigma in enumerate((*widths, beam.axial / geometry.sample_pitch), start=1):
        field = gaussian_filter1d(field, sigma, axis=axis, mode="wrap")
    field /= np.sqrt(2 * field.var())
    return (field[0] + 1j * field[1]).astype(np.complex64)


def gain_errors(error_db: float, samples: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (samples,) errors of the gain in dB, linear between the sliders that a person set."""
    errors = error_db * rng.standard_normal(_SLIDERS)
    return np.interp(np.linspace(0, _SLIDERS - 1, samples), np.arange(_SLIDERS), errors)
