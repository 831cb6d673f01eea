"""From the samples of a sweep to a Cartesian grid, and what is needed for it once per grid."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.ultrasound.sweep import Sweep, SweepGeometry
from sonoservo.systems.ultrasound.volume import Volume
from sonoservo.systems.values import require, require_positive

_TABLE_STEP = 0.1e-3
"""Step in m of the line-and-sample table; its interpolation errs by under 1e-3 of a sample."""


@dataclass(frozen=True, eq=False)
class CartesianGrid:
    """A regular grid in the probe frame P.

    Parameters
    ----------
    origin, spacing
        (3,) position of the first element and distance between elements, in m.
    shape
        Number of elements along X, Y, Z.
    """

    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    shape: tuple[int, ...]

    def axis(self, which: int) -> NDArray[np.float64]:
        """Positions of the elements along X (0), Y (1) or Z (2), in m."""
        return self.origin[which] + self.spacing[which] * np.arange(self.shape[which])


def sector_bounds(geometry: SweepGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper corner, (3,) each in m in P, of the box around the swept sector."""
    k, j, i = np.meshgrid(
        np.linspace(0, geometry.frames - 1, 41),
        np.linspace(0, geometry.lines - 1, 41),
        [0, geometry.samples - 1],
        indexing="ij",
    )
    corners = np.concatenate([geometry.position(k, j, i, d).reshape(-1, 3) for d in (1, -1)])
    return corners.min(axis=0), corners.max(axis=0)


def make_grid(
    geometry: SweepGeometry,
    spacing: ArrayLike,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
) -> CartesianGrid:
    """Make the grid that covers a box, by default the whole sector.

    Parameters
    ----------
    geometry
        Of the sweeps that will be converted.
    spacing
        One distance in m, or one for each axis.
    lower, upper
        (3,) corners of the box in P, in m: a region of interest is converted as fast as it is
        small.

    Raises
    ------
    ValueError
        If a spacing is not above zero, or the box is empty.
    """
    step = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    require_positive(**{f"spacing[{axis}]": s for axis, s in enumerate(step)})
    sector_lower, sector_upper = sector_bounds(geometry)
    low = sector_lower if lower is None else np.asarray(lower, dtype=float)
    high = sector_upper if upper is None else np.asarray(upper, dtype=float)
    require(bool((high > low).all()), "upper", high.tolist(), f"above the lower corner {low}")
    shape = np.floor((high - low) / step + 1e-9).astype(int) + 1
    # Centred, so that what is left over is shared by both sides.
    origin = 0.5 * (low + high) - 0.5 * step * (shape - 1)
    return CartesianGrid(origin, step, tuple(int(n) for n in np.maximum(shape, 2)))


class ScanConversion:
    """Scan conversion of sweeps of one geometry onto one grid.

    A voxel's distance q from the array's centre of curvature, within the plane of its line, and
    its angle about the motor's axis depend on Y and Z only; its line and sample on X and q only.
    So two small tables, (ny, nz) and (nx, nq), replace a table with an entry for every voxel.

    Parameters
    ----------
    geometry
        Of the sweeps.
    grid
        Of the volumes.
    """

    def __init__(self, geometry: SweepGeometry, grid: CartesianGrid) -> None:
        self.geometry = geometry
        self.grid = grid
        offset = geometry.array_radius - geometry.motor_radius
        y = grid.axis(1)[:, np.newaxis] + geometry.motor_radius
        z = grid.axis(2)[np.newaxis, :]
        x = grid.axis(0)[:, np.newaxis]
        q = offset + np.hypot(y, z)
        sweep_angle = geometry.frame_pitch * geometry.frames
        self._step = (
            (np.arctan2(z, y) / sweep_angle + 0.5) * (geometry.frames * geometry.lines - 1)
        ).astype(np.float32)
        self._first_q = float(q.min())
        self._q = ((q - self._first_q) / _TABLE_STEP).astype(np.float32)
        q_axis = self._first_q + _TABLE_STEP * np.arange(int(self._q.max()) + 3)
        self._line = (
            np.arctan2(x, q_axis) / geometry.line_pitch + (geometry.lines - 1) / 2
        ).astype(np.float32)
        self._sample = (
            (np.hypot(x, q_axis) - geometry.array_radius) / geometry.sample_pitch
        ).astype(np.float32)

    def convert(self, samples: NDArray[np.uint8], direction: int) -> NDArray[np.uint8]:
        """Interpolate (frames, lines, samples) to (nx, ny, nz), trilinear and rounded.

        Zero outside the part of the sector that both motor directions sweep.
        """
        return _convert(samples, self._step, self._q, self._line, self._sample, direction)

    def __call__(self, sweep: Sweep) -> Volume:
        """Convert a sweep; the volume's pose and time are those of the middle frame."""
        motion = sweep.motion
        middle = self.geometry.frames // 2
        return Volume(
            intensities=self.convert(sweep.samples, motion.direction),
            origin=self.grid.origin,
            spacing=self.grid.spacing,
            X_WP=RigidTransform(motion.X_WP[middle]),
            time=float(motion.times[middle]),
            motion=motion,
        )


@numba.njit(cache=True, parallel=True, fastmath=True)
def _convert(samples, step, q, line, sample, direction):  # type: ignore[no-untyped-def]
    frames, lines, depth = samples.shape
    nx, (ny, nz) = line.shape[0], step.shape
    volume = np.zeros((nx, ny, nz), np.uint8)
    for x in numba.prange(nx):
        for y in range(ny):
            for z in range(nz):
                entry = int(q[y, z])
                part = q[y, z] - entry
                j = line[x, entry] + part * (line[x, entry + 1] - line[x, entry])
                i = sample[x, entry] + part * (sample[x, entry + 1] - sample[x, entry])
                if not (0 <= j <= lines - 1 and 0 <= i <= depth - 1):
                    continue
                u = step[y, z]
                mirrored = lines - 1 - j
                if u < max(j, mirrored) or u - min(j, mirrored) > lines * (frames - 1):
                    continue
                k = (u - (j if direction > 0 else mirrored)) / lines
                k0 = min(int(k), frames - 2)
                j0 = min(int(j), lines - 2)
                i0 = min(int(i), depth - 2)
                fk, fj, fi = k - k0, j - j0, i - i0
                total = np.float32(0.5)
                for dk in range(2):
                    wk = fk if dk else 1 - fk
                    for dj in range(2):
                        w = wk * (fj if dj else 1 - fj)
                        a = samples[k0 + dk, j0 + dj, i0]
                        b = samples[k0 + dk, j0 + dj, i0 + 1]
                        total += w * (a + fi * (np.float32(b) - np.float32(a)))
                volume[x, y, z] = np.uint8(total)
    return volume
