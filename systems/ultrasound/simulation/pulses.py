"""Tables of the pulse that an echo leaves along a scan line."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.projection import FRACTIONS
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import LANES

_RING_DOWN_STEP = 0.4e-3
_RING_DOWN_DECADES = 1.5


class PulseTables:
    """Pulses of one beam, sampled along a line.

    Parameters
    ----------
    beam
        Point spread function.
    pitch
        Distance between samples, in m.

    Attributes
    ----------
    lead
        Number of samples from the beginning of a pulse to the one before its middle.
    """

    def __init__(self, beam: Beam, pitch: float) -> None:
        half_taps = 2 * int(np.ceil(3 * beam.axial / pitch / 2))
        self.lead = half_taps - 1
        self._taps = 2 * half_taps
        self._beam = beam
        self._pitch = pitch

    def tabulate(
        self, levels: Sequence[complex], distances: Sequence[float]
    ) -> NDArray[np.float32]:
        """Return a (FRACTIONS + 1, 2 taps) pulse with echoes at given distances in m.

        Real and imaginary parts alternate; the width is a multiple of `LANES`.
        """
        pitch = self._pitch
        taps = self._taps + int(np.ceil(distances[-1] / pitch))
        fraction = np.arange(FRACTIONS + 1)[:, np.newaxis] / FRACTIONS
        path = (np.arange(taps) - self.lead - fraction) * pitch
        table = np.zeros(path.shape, complex)
        for level, distance in zip(levels, distances, strict=True):
            behind = path - distance
            phase = -4 * np.pi * distance / self._beam.wavelength
            table += level * np.exp(1j * phase - behind**2 / (2 * self._beam.axial**2))
        table = np.pad(table, ((0, 0), (0, -taps % (LANES // 2))))
        return table.astype(np.complex64).view(np.float32)

    def ring_down(
        self, level_db: float, length: float, depth: float, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return the pulse of a noise-like reverberation behind an echo.

        Parameters
        ----------
        level_db, length
            See `SurfaceEcho`.
        depth
            Depth of the deepest sample, in m.
        rng
            Generator that draws the reverberation.
        """
        distances = np.arange(1, min(_RING_DOWN_DECADES * length, depth) / _RING_DOWN_STEP)
        distances = distances * _RING_DOWN_STEP
        # Echoes of random phase add up to this level on average.
        overlap = np.sqrt(np.pi) * self._beam.axial / _RING_DOWN_STEP
        levels = rng.normal(size=(len(distances), 2)) @ [1, 1j] / np.sqrt(2 * overlap)
        levels = levels * 10 ** (level_db / 20 - distances / length)
        return self.tabulate([*levels], [*distances])


def stacked(tables: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Stack pulses to (kinds (FRACTIONS + 1), widest); return also their (kinds,) widths."""
    widths = np.array([table.shape[1] for table in tables])
    widest = widths.max()
    return np.concatenate([np.pad(t, ((0, 0), (0, widest - t.shape[1]))) for t in tables]), widths
