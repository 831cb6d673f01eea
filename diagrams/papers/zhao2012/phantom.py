"""Simulated phantom of Zhao, Liebgott and Cachard 2012, section 3."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import load_transducer

IMAGING = ImagingParameters(
    depth=0.07435,
    sector=1.0,
    transmit_frequency=7.5e6,
    focus_depth=0.05,
    frame_pitch_deg=0.7547,
    volume_rate=1.0,
    frames=53,
    sample_pitch=2.8519e-5,
)
"""Settings of the scanner in Table 1: 53 x 71 x 2608 samples. The rate is not published and not
used: all lines of a volume are acquired at once."""

SIZE = (0.05, 0.05, 0.03)
"""Extents of the phantom in m."""

FACE_HEIGHT = 0.035
"""Height of the probe over the phantom in m, with the focus at its centre; not published."""

DIRECTION = np.array([0.94, 0.0, -0.34]) / np.hypot(0.94, 0.34)
"""Published direction of the needle, in T: its third component points into the phantom."""

TOWARDS = np.array([1.0, 0.0, 0.0])
"""Rough direction of every needle, in T: it enters from the left, as the person who pushes it
knows. It tells which end is the tip."""

_NEEDLE_RADIUS = 0.5e-3
_NEEDLE_DENSITY = 125e9
_TISSUE_DENSITY = 10e9
_NEEDLE_AMPLITUDE = 7.5
_TISSUE_AMPLITUDE = 2.0
"""Root mean square of the K distribution, 2 sqrt(nu) / lambda, with lambda = sqrt(nu)."""
_SCATTERERS_PER_CELL = 1.75
"""Effective number of scatterers in a resolution cell at the focus with the published density: the
speckle is not fully developed. Their published amplitudes scatter, those of the renderer do not."""
_NOISE_DB = -40.0
"""Electronic noise relative to the tissue's root mean square; the paper publishes none."""
_LONGEST_NEEDLE = 25e-3


@dataclass(frozen=True)
class StraightNeedle:
    """A straight needle in T: (3,) rear end in m, and unit vector towards the tip."""

    start: NDArray[np.float64]
    direction: NDArray[np.float64]

    def tip(self, length: float) -> NDArray[np.float64]:
        """Return the (3,) position of the tip in T, in m, for a length of the needle in m."""
        return self.start + length * self.direction


class Phantom:
    """A phantom with a needle, and a probe at rest above it; ``seed`` is that of all scatterers.

    T is the world frame. The needle consists of scatterers that move with it, 22 dB above the
    tissue's where the beam lies inside the needle. The tissue does not deform. The lines contain
    electronic noise.
    """

    def __init__(self, needle: StraightNeedle, seed: int) -> None:
        self.needle = needle
        self._seed = seed
        tissue = Tissue(
            size=list(SIZE), scatterers_per_cell=_SCATTERERS_PER_CELL, attenuation=0.0, seed=seed
        )
        self.renderer = SweepRenderer(
            transducer=load_transducer("zhao2012"),
            imaging=IMAGING,
            tissue=tissue,
            parameters=ScannerParameters(
                noise_db=-55, gain_error_db=0, clutter_db=-300, decorrelation=0
            ),
            seed=seed,
        )
        self.X_WP = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0, 0, FACE_HEIGHT])
        self._at_rest = SweepMotion.at_rest(self.renderer.geometry, self.X_WP, 0.0)
        self._tissue = self.renderer.tissue_echo(self._at_rest.X_WP, 1)
        rng = np.random.default_rng([seed, 2])
        count = rng.poisson(_NEEDLE_DENSITY * np.pi * _NEEDLE_RADIUS**2 * _LONGEST_NEEDLE)
        radius = _NEEDLE_RADIUS * np.sqrt(rng.random(count))
        angle = rng.uniform(0, 2 * np.pi, count)
        self._behind = _LONGEST_NEEDLE * rng.random(count)
        self._across = radius[:, np.newaxis] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # A volume full of scatterers of amplitude a and density n has the power n a^2 per
        # resolution cell; the tissue's is 1.
        contrast = _NEEDLE_DENSITY * _NEEDLE_AMPLITUDE**2 / (_TISSUE_DENSITY * _TISSUE_AMPLITUDE**2)
        focus = round(IMAGING.focus_depth / IMAGING.sample_pitch)
        cell = self.renderer.beam.resolution_cell[focus]
        self._amplitude = np.sqrt(contrast / (_NEEDLE_DENSITY * cell))

    def sweep(self, length: float, time: float) -> RadioFrequencySweep:
        """Acquire all radio-frequency lines at one time in s, for a length of the needle in m."""
        require_positive(length=length)
        k = self.needle.direction
        basis = np.linalg.svd(k[np.newaxis])[2][1:]
        inside = self._behind < length
        points = self.needle.tip(length) - np.outer(self._behind[inside], k)
        points += self._across[inside] @ basis
        iq = self._tissue.copy()
        amplitudes = np.full(len(points), self._amplitude, complex)
        self.renderer.add_scatterers(iq, self._at_rest.X_WP, points, amplitudes, 1)
        lines = self.renderer.on_carrier(iq)
        rng = np.random.default_rng([self._seed, 7, round(1e3 * time), round(1e6 * length)])
        # The carrier has half the power of the envelope, which is 1 in the tissue.
        level = 10 ** (_NOISE_DB / 20) / np.sqrt(2)
        lines += np.float32(level) * rng.standard_normal(lines.shape, dtype=np.float32)
        motion, spread = self._at_rest.at_once(time), self.renderer.point_spread
        return RadioFrequencySweep(seal(lines), motion, spread)
