"""Scan conversion of a sweep's samples onto a Cartesian grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.motion_resampling import (
    FRAMES_BEYOND,
    NODE_STRIDE,
    POSES_PER_FRAME,
    resample_moving,
    tabulate_shifts,
)
from sonoservo.systems.ultrasound.resampling import (
    WIDEST_ANGLE,
    Sector,
    pack_corners,
    resample,
    rows_in_sector,
)

_SLACK = 1e-6
"""Length in m that exceeds the rounding errors of single precision."""


@dataclass(frozen=True, eq=False)
class CartesianGrid:
    """A regular grid in P, with the first element at (3,) ``origin`` and (3,) ``spacing``, in m."""

    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    shape: tuple[int, ...]

    def axis(self, which: int) -> NDArray[np.float64]:
        """Return the positions of the elements along X (0), Y (1) or Z (2), in m."""
        return self.origin[which] + self.spacing[which] * np.arange(self.shape[which])


def sector_bounds(geometry: SweepGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (3,) lower and upper corners of the swept sector's bounding box, in P, in m."""
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
        Geometry of the sweeps to convert.
    spacing
        Distance between elements in m: one for all axes, or one for each.
    lower, upper
        (3,) corners of the box in P, in m. A smaller region of interest is converted faster.

    Raises
    ------
    ValueError
        If a spacing is not above zero, the box is empty, or a sweep has a single frame.
    """
    require(geometry.frames >= 2, "frames", geometry.frames, "at least 2, to make a volume")
    step = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    require_positive(**{f"spacing[{axis}]": s for axis, s in enumerate(step)})
    sector_lower, sector_upper = sector_bounds(geometry)
    low = sector_lower if lower is None else np.asarray(lower, dtype=float)
    high = sector_upper if upper is None else np.asarray(upper, dtype=float)
    require(bool((high > low).all()), "upper", high.tolist(), f"above the lower corner {low}")
    shape = np.floor((high - low) / step + 1e-9).astype(int) + 1
    # Centred, so that both sides share the remainder.
    origin = 0.5 * (low + high) - 0.5 * step * (shape - 1)
    return CartesianGrid(origin, step, tuple(int(n) for n in np.maximum(shape, 2)))


class ScanConversion:
    """Scan conversion of sweeps of one geometry onto one grid.

    An element's distance q from the array's centre of curvature, within the plane of its line, and
    its angle about the motor's axis depend only on Y and Z. Two tables of (ny, nz) numbers are
    therefore all that is precomputed. The element's line and sample follow from X and q.

    Parameters
    ----------
    geometry
        Geometry of the sweeps.
    grid
        Grid of the volumes.
    compensate_motion
        Whether a volume shows the tissue as a probe at rest at the pose of the middle frame would
        have seen it. Every element is then looked up in the frame that saw its place in the world,
        with the probe's pose at that time; the tissue is assumed to be at rest. Otherwise, an
        element shows what was at its place in the probe's frame.

    Raises
    ------
    ValueError
        If the sector reaches further than 77 deg from its middle.
    """

    def __init__(
        self, geometry: SweepGeometry, grid: CartesianGrid, *, compensate_motion: bool = False
    ) -> None:
        line_angle = 0.5 * geometry.line_pitch * geometry.lines
        frame_angle = 0.5 * geometry.frame_pitch * geometry.frames
        for name, angle in (("line_pitch", line_angle), ("frame_pitch", frame_angle)):
            allowed = f"such that the sector reaches to {WIDEST_ANGLE:.2f} rad on either side"
            require(angle <= WIDEST_ANGLE, name, getattr(geometry, name), allowed)
        self.geometry = geometry
        self.grid = grid
        self.compensate_motion = compensate_motion
        steps = geometry.frames * geometry.lines - 1
        numbers = {
            "array_radius": geometry.array_radius,
            "centre_offset": geometry.array_radius - geometry.motor_radius,
            "samples_per_metre": 1 / geometry.sample_pitch,
            "lines_per_radian": 1 / geometry.line_pitch,
            "steps_per_radian": steps / (geometry.frame_pitch * geometry.frames),
            "lines": geometry.lines,
            "last_frame": geometry.frames - 1,
            "last_line": geometry.lines - 1,
            "last_sample": geometry.samples - 1,
        }
        self._sector = Sector(
            direction=np.float32(1), **{name: np.float32(value) for name, value in numbers.items()}
        )
        x, y, z = grid.axis(0), grid.axis(1) + geometry.motor_radius, grid.axis(2)
        q = numbers["centre_offset"] + np.hypot(y[:, np.newaxis], z)
        step = numbers["steps_per_radian"] * np.arctan2(z, y[:, np.newaxis])
        self._axes = [axis.astype(np.float32) for axis in (x, y, z)]
        self._rows = rows_in_sector(self._sector, _SLACK, *self._axes)
        self._distance, self._step = q.astype(np.float32), step.astype(np.float32)
        self._first, self._last = self._cells(x, q, step)

    def __call__(self, sweep: Sweep) -> Volume:
        """Convert a sweep; the volume's pose and time are those of the middle frame.

        If the motion is compensated, the volume's `motion` has the middle frame's pose for every
        frame, and keeps the times at which the frames were acquired.
        """
        motion = sweep.motion
        middle = self.geometry.frames // 2
        mask = None  # what lies in the sector was seen, unless the probe moved
        if self.compensate_motion:
            intensities, mask = self._convert_moving(sweep.samples, motion)
            at_rest = np.broadcast_to(motion.X_WP[middle], motion.X_WP.shape)
            motion = SweepMotion(self.geometry, motion.direction, motion.times, at_rest)
        else:
            intensities = self.convert(sweep.samples, motion.direction)
        return Volume(
            intensities=seal(intensities),
            origin=self.grid.origin,
            spacing=self.grid.spacing,
            X_WP=RigidTransform(motion.X_WP[middle]),
            time=float(motion.times[middle]),
            motion=motion,
            decibels_per_level=sweep.decibels_per_level,
            point_spread=sweep.point_spread,
            mask=mask,
        )

    def convert(self, samples: NDArray[np.uint8], direction: int) -> NDArray[np.uint8]:
        """Interpolate the (frames, lines, samples) of a probe at rest, trilinearly and rounded.

        The (nx, ny, nz) grey levels are zero where not both directions of the motor sweep.
        """
        volume = np.zeros(self.grid.shape, np.uint8)
        resample(
            volume,
            self._rows,
            *pack_corners(samples, self._first, self._last),
            self._sector._replace(direction=np.float32(direction)),
            self._axes[0],
            self._distance,
            self._step,
        )
        return volume

    def _convert_moving(
        self, samples: NDArray[np.uint8], motion: SweepMotion
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
        """Return grey levels, and what was seen unless that is the sector of a probe at rest."""
        geometry = self.geometry
        poses = _relative_poses(motion)
        corners = np.stack(np.meshgrid(*([a[0], a[-1]] for a in self._axes)), -1).reshape(-1, 3)
        moved = corners @ poses[:, :, :3].swapaxes(1, 2) + poses[:, np.newaxis, :, 3]
        margin = np.abs(moved - corners).max(axis=(0, 1)) + _SLACK
        sector = self._sector._replace(direction=np.float32(motion.direction))
        nodes = [_nodes(axis) for axis in self._axes]
        shifts = np.empty((len(nodes[0]), len(nodes[1]), 3, len(nodes[2])), np.float32)
        tabulate_shifts(shifts, sector, *nodes, poses.reshape(-1, 12).astype(np.float32))
        rows = rows_in_sector(self._sector, margin, *self._axes)
        nodes_row = np.empty((len(self._axes[0]), 3, len(nodes[2])), np.float32)
        row = np.empty((len(self._axes[0]), 3, NODE_STRIDE * len(nodes[2])), np.float32)

        volume = np.zeros(self.grid.shape, np.uint8)
        seen = np.zeros(self.grid.shape, np.uint8)
        packed = pack_corners(samples, (0, 0, 0), tuple(n - 2 for n in geometry.shape))
        resample_moving(
            volume, seen, rows, *packed, sector, self._axes[0], self._distance, self._step, shifts,
            nodes_row, row,
        )  # fmt: skip
        return volume, None if margin.max() < 0.5 * self.grid.spacing.min() else seal(
            seen.view(np.bool_)
        )

    def _cells(
        self, x: NDArray[np.float64], q: NDArray[np.float64], step: NDArray[np.float64]
    ) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return frame, line and sample of the first and last cells that the grid needs."""
        geometry, sector = self.geometry, self._sector
        line = np.arctan2([[x[0]], [x[-1]]], [q.min(), q.max()]) * sector.lines_per_radian
        twist = np.abs(line).max()
        frame = np.array([step.min() - twist, step.max() + twist]) / geometry.lines
        r = np.hypot([np.clip(0, x[0], x[-1]), np.abs(x).max()], [q.min(), q.max()])
        places = [
            frame + 0.5 * sector.last_frame,
            line + 0.5 * sector.last_line,
            (r - geometry.array_radius) / geometry.sample_pitch,
        ]
        first, last = (
            tuple(
                int(np.clip(np.floor(extreme(place)), 0, n - 2))
                for place, n in zip(places, geometry.shape, strict=True)
            )
            for extreme in (np.min, np.max)
        )
        return first, last


def _nodes(axis: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the coordinates of every `NODE_STRIDE`-th element, to beyond the last one."""
    numbers = NODE_STRIDE * np.arange((len(axis) - 1) // NODE_STRIDE + 2)
    return (axis[0] + (axis[1] - axis[0]) * numbers).astype(np.float32)


def _relative_poses(motion: SweepMotion) -> NDArray[np.float64]:
    """Return (n, 3, 4) transforms from the middle frame's pose to those at fractions of frames.

    Origins are on the motor's axis; see `tabulate_shifts`.
    """
    geometry = motion.geometry
    count = POSES_PER_FRAME * (geometry.frames - 1 + 2 * FRAMES_BEYOND) + 1
    frame = np.arange(count) / POSES_PER_FRAME - FRAMES_BEYOND
    below = np.clip(frame.astype(int), 0, geometry.frames - 2)
    part = (frame - below)[:, np.newaxis, np.newaxis]
    X_WP = (1 - part) * motion.X_WP[below] + part * motion.X_WP[below + 1]
    X_PA = np.eye(4)
    X_PA[1, 3] = -geometry.motor_radius
    X_PP = np.linalg.inv(X_WP) @ motion.X_WP[geometry.frames // 2]
    return (np.linalg.inv(X_PA) @ X_PP @ X_PA)[:, :3]
