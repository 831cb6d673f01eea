"""Pulses, tabulated for fractions of a sample, and the geometry of lines and frames."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import (
    ELEVATION_LOBES,
    SIDE_LOBE_WIDTH,
)
from sonoservo.systems.ultrasound.simulation.kernels.echo import FADE
from sonoservo.systems.ultrasound.simulation.kernels.projection import FRACTIONS, Rays
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import LANES

_RING_DOWN_STEP = 0.4e-3
_RING_DOWN_DECADES = 1.5


class PulseTables:
    """Pulses of one beam, sampled along a line with a pitch in m.

    ``lead`` is the number of samples from the beginning of a pulse to the one before its middle.
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
        """Return the pulse of a noise-like reverberation behind an echo; see `SurfaceEcho`."""
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


def projection_rays(
    geometry: SweepGeometry, beam: Beam, direction: int, lead: int, reference: int
) -> Rays:
    """Return the quantities with which the kernels project points onto the lines of a sweep.

    Geometry has lengths in the tissue; levels of bright points hold at the sample ``reference``.
    """
    steps = geometry.frames * geometry.lines - 1
    cell = beam.resolution_cell
    return Rays(
        array_radius=np.float32(geometry.array_radius),
        centre_offset=np.float32(geometry.array_radius - geometry.motor_radius),
        lines_per_radian=np.float32(1 / geometry.line_pitch),
        middle_line=np.float32((geometry.lines - 1) / 2),
        twist=np.float32(direction * geometry.frame_pitch * geometry.frames / steps),
        samples_per_metre=np.float32(1 / geometry.sample_pitch),
        turns_per_metre=np.float32(2 / beam.wavelength),
        lead=lead,
        elevation_lobes=np.float32(ELEVATION_LOBES[0] * (beam.side_lobes > 0)),
        side_lobes=np.float32(beam.side_lobes / SIDE_LOBE_WIDTH),
        elevation_precision=(0.5 / beam.elevation**2).astype(np.float32),
        curvature=beam.curvature.astype(np.float32),
        share=(cell.min() / cell / (1 + FADE)).astype(np.float32),
        line_sigma=line_widths(geometry, beam).astype(np.float32),
        bright=np.sqrt(cell[reference] / cell).astype(np.float32),
    )


def line_widths(geometry: SweepGeometry, beam: Beam) -> NDArray[np.float64]:
    """Return the beam's (samples,) lateral standard deviations, in lines."""
    depths = geometry.sample_pitch * np.arange(geometry.samples)
    radii = np.maximum(geometry.array_radius + depths, geometry.sample_pitch)
    return beam.lateral / (geometry.line_pitch * radii)


def motor_poses(geometry: SweepGeometry) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses of the probe in F."""
    theta = geometry.line_angles(1).mean(axis=1)
    X_FP = np.zeros((len(theta), 4, 4))
    X_FP[:, 0, 0] = X_FP[:, 3, 3] = 1
    X_FP[:, 1, 1] = X_FP[:, 2, 2] = np.cos(theta)
    X_FP[:, 1, 2] = np.sin(theta)
    X_FP[:, 2, 1] = -np.sin(theta)
    X_FP[:, :, 3] += X_FP[:, :, 1] * geometry.motor_radius
    return X_FP


def frame_poses(X_FP: NDArray[np.float64], X_TP: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 3, 4) poses of the tissue in F, of (n, 4, 4) poses of the probe in F and in T."""
    return np.ascontiguousarray((X_FP @ np.linalg.inv(X_TP))[:, :3])


def line_rays(
    geometry: SweepGeometry, direction: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (frames, lines, 3) origins on the face and unit directions of all lines, in P."""
    frames, lines, _ = np.ogrid[: geometry.frames, : geometry.lines, :1]
    start = geometry.position(frames, lines, 0, direction)[:, :, 0]
    along = geometry.position(frames, lines, 1, direction)[:, :, 0] - start
    return start, along / geometry.sample_pitch
