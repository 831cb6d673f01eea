"""Radio-frequency sweeps, and the grey levels that a scanner makes of them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.ultrasound.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.values import Immutable, require

_DISCARDED_BITS = 16
"""Of a single-precision number; the 7 bits of mantissa that are left resolve 0.05 dB."""


@dataclass(frozen=True, eq=False)
class RadioFrequencySweep(Immutable):
    """The echoes of one sweep on their carrier, before any detection.

    Parameters
    ----------
    lines
        (frames, lines, samples) float32. Their values are not looked at here: it would take as
        long as all else that is done with them.
    motion
        When and from where each frame was acquired.
    """

    lines: NDArray[np.float32]
    motion: SweepMotion

    def __post_init__(self) -> None:
        lines = np.asarray(self.lines, dtype=np.float32).view()
        shape = self.motion.geometry.shape
        require(lines.shape == shape, "lines.shape", lines.shape, f"{shape}")
        lines.flags.writeable = False
        object.__setattr__(self, "lines", lines)

    @property
    def time(self) -> float:
        """Middle of the acquisition, in s."""
        return self.motion.time

    @property
    def X_WP(self) -> RigidTransform:
        """Pose of the probe in the world when the middle frame was acquired."""
        return RigidTransform(self.motion.X_WP[self.motion.geometry.frames // 2])

    def index(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """(..., 3) frame, line and sample, fractions included, of (..., 3) positions in P, in m."""
        return np.stack(self.motion.geometry.index(p_P, self.motion.direction), axis=-1)

    def position(self, index: ArrayLike) -> NDArray[np.float64]:
        """(..., 3) positions in P, in m, of (..., 3) frames, lines and samples."""
        k, j, i = np.moveaxis(np.asarray(index, dtype=float), -1, 0)
        return self.motion.geometry.position(k, j, i, self.motion.direction)

    def to_world(self, p_P: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions in W, in m, and times, in s, at which (m, 3) positions in P were acquired."""
        return self.motion.to_world(p_P)

    def to_probe(self, p_W: ArrayLike) -> NDArray[np.float64]:
        """(m, 3) positions in P, in m, of positions in W, for the pose `X_WP`."""
        return self.X_WP.inverse().multiply(np.asarray(p_W, dtype=float).T).T.reshape(-1, 3)


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
    """Make grey levels of radio-frequency lines, on fewer samples.

    A peak detector: each sample is the largest magnitude within half a step before and behind it.
    Over a step of a carrier's period or more it is at most 1 dB below the envelope.

    Parameters
    ----------
    sweep
        To detect.
    step
        Samples of the lines for each sample of the result.
    floor_db
        Amplitude of grey level 0, over an echo of amplitude 1.
    dynamic_range_db
        Range of amplitudes that the grey levels 0 to 255 show.
    near, far
        Depths in m between which the lines are looked at; elsewhere the result is 0.
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
    return Sweep(grey, replace(sweep.motion, geometry=geometry))


def detected_geometry(geometry: SweepGeometry, step: int) -> SweepGeometry:
    """Geometry of a sweep of which every ``step``-th sample is left."""
    samples = (geometry.samples - 1) // step + 1
    return replace(geometry, samples=samples, sample_pitch=step * geometry.sample_pitch)
