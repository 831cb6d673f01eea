"""Envelope detection of radio-frequency sweeps."""

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit, prange

from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry

_DISCARDED_BITS = 16
"""Discarded bits of a single-precision number; the remaining 7 mantissa bits resolve 0.05 dB."""


@njit(parallel=True, cache=True, nogil=True)
def _detect_peaks(
    lines: Any, grey: Any, step: int, begin: int, end: int, table: Any, shift: Any
) -> None:
    frames, count, samples = lines.shape
    for k in prange(frames):  # pragma: no cover - compiled
        peak = np.empty(1, np.float32)
        bits = peak.view(np.uint32)
        for j in range(count):
            for i in range(begin, end):
                peak[0] = 0.0
                for s in range(
                    max(i * step - step // 2, 0), min(i * step + step // 2 + 1, samples)
                ):
                    peak[0] = max(peak[0], abs(lines[k, j, s]))
                grey[k, j, i] = table[bits[0] >> shift]


def detect_envelope(
    sweep: RadioFrequencySweep,
    *,
    step: int,
    floor_db: float,
    dynamic_range_db: float = 60.0,
    near: float = 0.0,
    far: float = np.inf,
) -> Sweep:
    """Convert radio-frequency lines to grey levels at every ``step``-th sample, by a peak detector.

    A sample is the largest magnitude within half a step, at most 1 dB below the envelope for steps
    of a carrier's period or more. ``floor_db`` is that of grey level 0, relative to an echo of
    amplitude 1; the result is 0 outside the depths ``near`` to ``far`` in m.
    """
    require(step >= 1, "step", step, "1 or more")
    geometry = detected_geometry(sweep.motion.geometry, step)
    codes = np.arange(2 ** (32 - _DISCARDED_BITS - 1), dtype=np.uint32) << _DISCARDED_BITS
    codes[1:] += np.uint32(2 ** (_DISCARDED_BITS - 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        level = 20 * np.log10(codes.view(np.float32).astype(float)) - floor_db
    grey_per_db = 255 / dynamic_range_db
    table = np.round(np.clip(np.nan_to_num(grey_per_db * level), 0, 255)).astype(np.uint8)
    grey = np.zeros(geometry.shape, np.uint8)
    begin, end = (
        int(min(depth / geometry.sample_pitch, geometry.samples)) for depth in (near, far)
    )
    _detect_peaks(sweep.lines, grey, step, begin, end, table, np.uint32(_DISCARDED_BITS))
    motion = replace(sweep.motion, geometry=geometry)
    return Sweep(seal(grey), motion, dynamic_range_db / 255, sweep.point_spread)


def detected_geometry(geometry: SweepGeometry, step: int) -> SweepGeometry:
    """Return the geometry of a sweep after keeping every ``step``-th sample."""
    samples = (geometry.samples - 1) // step + 1
    return replace(geometry, samples=samples, sample_pitch=step * geometry.sample_pitch)
