"""One sweep of a motorised probe: its geometry, its motion and its samples."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA, PointSpread
from sonoservo.systems.signals.requirements import NotNegative, Positive, at_least, require

DECIBELS_PER_LEVEL = 60 / 255
"""Default of the decibels per grey level of an image: 0 to 255 show 60 dB."""

DYNAMIC_RANGE_DB = 1.0, 1000.0
"""Limits of the range of echo amplitudes that grey levels 0 to 255 show, in dB."""


@dataclass(frozen=True)
class SweepGeometry(Immutable):
    """Geometry and timing of a sweep's samples in the probe frame P.

    The array is an arc of lines in the X-Y plane. Its centre of curvature lies
    ``array_radius - motor_radius`` beyond the motor's axis. The motor turns the arc about X.
    It never stops, so every line has an angle of its own. Line j of frame k is at

        phi   = line_pitch (j - (lines - 1) / 2)
        theta = frame_pitch frames ((s + lines k) / (frames lines - 1) - 1/2)
        s     = j on a sweep towards +Z, lines - 1 - j on a sweep towards -Z

    and its sample i at r = array_radius + sample_pitch i lies at

        x = r sin(phi);  rho = r cos(phi) - (array_radius - motor_radius)
        y = rho cos(theta) - motor_radius;  z = rho sin(theta)

    (Lee and Krupa 2011, section II, with the origin moved to the centre of the probe's face.)
    If both radii are zero, the sector starts from a single point.

    Frames are numbered towards +Z for either direction of the motor.
    """

    array_radius: NotNegative
    motor_radius: NotNegative
    """Distances from the face to the array's centre of curvature and to the motor's axis, in m."""

    line_pitch: Positive
    frame_pitch: Positive
    """Angles between neighbouring lines and frames, in rad."""

    sample_pitch: Positive
    """Distance between neighbouring samples of a line, in m."""

    lines: Annotated[int, at_least(2)]
    """Number of lines in a frame."""

    frames: Annotated[int, at_least(1)]
    """Number of frames in a sweep; 1 for a single slice."""

    samples: Annotated[int, at_least(2)]
    """Number of samples in a line."""

    frame_period: Positive
    """Time between the starts of successive frames, in s."""

    sound_speed: Positive = 1540.0
    """Speed of sound, in m/s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        least = self.min_frame_period
        require(
            self.frame_period >= least * (1 - 1e-9),
            "frame_period",
            self.frame_period,
            f"at least {least:.6f} s: {self.lines} lines x 2 x {1e3 * self.depth:.1f} mm depth at "
            f"{self.sound_speed:.0f} m/s take that long",
        )

    @property
    def depth(self) -> float:
        """Distance from the face to a line's last sample, in m."""
        return self.sample_pitch * (self.samples - 1)

    @property
    def min_frame_period(self) -> float:
        """Time that sound needs for all lines of a frame, in s."""
        return self.lines * 2 * self.depth / self.sound_speed

    @property
    def period(self) -> float:
        """Duration of one sweep, in s."""
        return self.frames * self.frame_period

    @cached_property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of frames, lines and samples."""
        return (self.frames, self.lines, self.samples)

    @property
    def _centre_offset(self) -> float:
        """Distance from the motor's axis to the array's centre of curvature, in m."""
        return self.array_radius - self.motor_radius

    def frame_times(
        self, time: float, direction: int = 1, *, since: int = 0
    ) -> NDArray[np.float64]:
        """Return the (frames,) times in s of a sweep with ``since`` frames at a time."""
        order = np.arange(self.frames, dtype=np.float64)[::direction]
        return np.asarray(time + self.frame_period * (order - since))

    def line_angles(self, direction: int) -> NDArray[np.float64]:
        """Return the (frames, lines) angles theta of the lines about the motor's axis, in rad."""
        j = np.arange(self.lines)
        s = j if direction > 0 else self.lines - 1 - j
        k = np.arange(self.frames)[:, np.newaxis]
        return self._theta(s + self.lines * k)

    def _theta(self, step: ArrayLike) -> NDArray[np.float64]:
        fraction = np.asarray(step) / (self.frames * self.lines - 1) - 0.5
        return self.frame_pitch * self.frames * fraction

    def position(
        self, k: ArrayLike, j: ArrayLike, i: ArrayLike, direction: int
    ) -> NDArray[np.float64]:
        """Return (..., 3) positions in P, in m, of (fractional) sample i on line j of frame k.

        The direction is +1 for a sweep towards +Z, -1 towards -Z.
        """
        k, j, i = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (k, j, i)))
        r = self.array_radius + self.sample_pitch * i
        phi = self.line_pitch * (j - (self.lines - 1) / 2)
        theta = self._theta((j if direction > 0 else self.lines - 1 - j) + self.lines * k)
        rho = r * np.cos(phi) - self._centre_offset
        return np.stack(
            [r * np.sin(phi), rho * np.cos(theta) - self.motor_radius, rho * np.sin(theta)], axis=-1
        )

    def index(self, p_P: ArrayLike, direction: int) -> tuple[NDArray[np.float64], ...]:
        """Return fractional frame, line and sample of positions in P; inverse of `position`."""
        p_P = np.asarray(p_P, dtype=float)
        found = np.empty((3, *p_P.shape[:-1]))
        _index(p_P.reshape(-1, 3), direction, self._numbers, found.reshape(3, -1))
        return tuple(found)

    @cached_property
    def _numbers(self) -> tuple[float, ...]:
        """Numbers that `_index` needs."""
        return (
            self.motor_radius, self.array_radius, self._centre_offset, self.sample_pitch,
            self.line_pitch, self.frame_pitch * self.frames, float(self.lines),
            float(self.frames * self.lines - 1),
        )  # fmt: skip

    def contains(self, p_P: ArrayLike) -> NDArray[np.bool_]:
        """Return True for positions in P in the part of the sector that both directions sweep."""
        p_P = np.asarray(p_P, dtype=float)
        inside = np.empty(p_P.shape[:-1], np.bool_)
        _contains(p_P.reshape(-1, 3), self._numbers, self.shape, inside.reshape(-1))
        return inside


@dataclass(frozen=True, eq=False)
class SweepMotion(Immutable):
    """Time and pose at which each frame of a sweep was acquired."""

    geometry: SweepGeometry

    direction: int
    """+1 for a sweep towards +Z, -1 towards -Z."""

    times: Annotated[NDArray[np.float64], Shape("f")]
    """Times of the frames in s. They descend with the frame's number if the direction is -1."""

    X_WP: Annotated[NDArray[np.float64], Shape("f", 4, 4)]
    """Poses of the probe in the world at the frames' times."""

    def __post_init__(self) -> None:
        require(self.direction in (1, -1), "direction", self.direction, "+1 or -1")
        super().__post_init__()

    def _extents(self) -> dict[str, int]:
        return {"f": self.geometry.frames}

    @classmethod
    def at_rest(
        cls, geometry: SweepGeometry, X_WP: RigidTransform, times: ArrayLike, direction: int = 1
    ) -> Self:
        """Return the motion by a probe at rest, with (frames,) times in s or one for all."""
        frames = geometry.frames
        poses = np.broadcast_to(X_WP.GetAsMatrix4(), (frames, 4, 4))
        return cls(geometry, direction, np.broadcast_to(times, frames), poses)

    @property
    def time(self) -> float:
        """Time of the middle of the sweep, in s."""
        return float(0.5 * (self.times[0] + self.times[-1]))

    def at_once(self, time: float) -> "SweepMotion":
        """Return the same motion with all frames acquired at ``time``, in s."""
        return replace(self, times=np.full(self.geometry.frames, time))

    def to_world(self, p_P: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (m, 3) positions in W and (m,) times at which (m, 3) positions in P were acquired.

        They are interpolated between the poses of the two nearest frames.
        """
        p_P = np.asarray(p_P, dtype=float)
        frames = self.geometry.index(p_P, self.direction)[0]
        p_W, times = np.empty(p_P.shape), np.empty(len(p_P))
        _to_world(p_P, frames, self.X_WP, self.times, p_W, times)
        return p_W, times


@njit(**OPTIONS)
def _index(p_P: Any, direction: int, numbers: Any, found: Any) -> None:  # pragma: no cover
    for m in range(len(p_P)):
        found[0, m], found[1, m], found[2, m] = _index_of(p_P[m], direction, numbers)


@njit(**OPTIONS)
def _contains(p_P: Any, numbers: Any, shape: Any, inside: Any) -> None:  # pragma: no cover
    frames, lines, samples = shape
    for m in range(len(p_P)):
        k, j, i = _index_of(p_P[m], 1, numbers)
        k_back = k + (2 * j - (lines - 1)) / lines
        inside[m] = 0 <= j <= lines - 1 and 0 <= i <= samples - 1
        inside[m] &= 0 <= k <= frames - 1 and 0 <= k_back <= frames - 1


@njit(**INNER)
def _index_of(p_P: Any, direction: int, numbers: Any) -> Any:  # pragma: no cover - compiled
    motor_radius, array_radius, offset, sample_pitch, line_pitch, sector, lines, steps = numbers
    x, y, z = p_P[0], p_P[1] + motor_radius, p_P[2]
    q = offset + math.hypot(y, z)
    line = math.atan2(x, q) / line_pitch + (lines - 1) / 2
    step = (math.atan2(z, y) / sector + 0.5) * steps
    frame = (step - (line if direction > 0 else lines - 1 - line)) / lines
    return frame, line, (math.hypot(q, x) - array_radius) / sample_pitch


@njit(**OPTIONS)
def _to_world(  # pragma: no cover - compiled
    p_P: Any, frames: Any, X_WP: Any, frame_times: Any, p_W: Any, times: Any
) -> None:
    last = len(frame_times) - 1
    for m in range(len(p_P)):
        frame = min(max(frames[m], 0.0), float(last))
        k = min(int(frame), max(last - 1, 0)) if frame == frame else 0
        above, weight = min(k + 1, last), frame - k
        x, y, z = p_P[m, 0], p_P[m, 1], p_P[m, 2]
        for row in range(3):
            # By element: an array for each row takes longer than the arithmetic.
            a = (1 - weight) * X_WP[k, row, 0] + weight * X_WP[above, row, 0]
            b = (1 - weight) * X_WP[k, row, 1] + weight * X_WP[above, row, 1]
            c = (1 - weight) * X_WP[k, row, 2] + weight * X_WP[above, row, 2]
            d = (1 - weight) * X_WP[k, row, 3] + weight * X_WP[above, row, 3]
            p_W[m, row] = a * x + c * z + b * y + d
        times[m] = (1 - weight) * frame_times[k] + weight * frame_times[above]


@dataclass(frozen=True, eq=False)
class MotionRecord(Immutable):
    """Motion of a sweep as it was measured and in truth; for logs only."""

    measured: SweepMotion
    true: SweepMotion


@dataclass(frozen=True, eq=False)
class Sweep(Immutable):
    """Pre-scan samples of one sweep."""

    samples: Annotated[NDArray[np.uint8], Shape("f", "l", "s", dtype=np.uint8)]
    """(frames, lines, samples) log-compressed echo amplitudes."""

    motion: SweepMotion

    decibels_per_level: Positive = DECIBELS_PER_LEVEL

    point_spread: PointSpread | None = None
    """Widths of a point's echo by depth; None if unknown."""

    def _extents(self) -> dict[str, int]:
        return dict(zip("fls", self.geometry.shape, strict=True))

    @property
    def geometry(self) -> SweepGeometry:
        """Geometry of the samples."""
        return self.motion.geometry

    def sample(self, p_P: ArrayLike, outside: float | None = 0.0) -> NDArray[np.float32]:
        """Return grey levels at (..., 3) positions in P of a probe at rest, trilinear."""
        index = np.stack(self.geometry.index(p_P, self.motion.direction), axis=-1)
        return sample_grid(self.samples, index, np.zeros(3), np.ones(3), outside)


Floats = NDArray[np.float64]


def blur_covariance(spread: PointSpread, geometry: SweepGeometry, p_P: Floats) -> Floats:
    """Return the (m, 3, 3) covariances in P, in m^2, of Gaussians that approximate echoes."""
    axes, depth = line_axes(geometry, p_P)
    scaled = axes * (spread.widths(depth) / FWHM_PER_SIGMA)[..., np.newaxis]
    return np.asarray(scaled.swapaxes(1, 2) @ scaled)


def line_axes(geometry: SweepGeometry, p_P: Floats) -> tuple[Floats, Floats]:
    """Return (m, 3, 3) unit vectors of the lines through (m, 3) positions in P, and (m,) depths."""
    x, y, z = np.asarray(p_P, dtype=float).T
    y = y + geometry.motor_radius
    q = np.hypot(y, z) + geometry.array_radius - geometry.motor_radius
    phi, theta = np.arctan2(x, q), np.arctan2(z, y)
    (c, s), (u, v) = ((np.cos(each), np.sin(each)) for each in (phi, theta))
    lateral, elevation, axial = [c, -s * u, -s * v], [np.zeros_like(c), -v, u], [s, c * u, c * v]
    axes = np.array([lateral, elevation, axial]).transpose(2, 0, 1)
    return axes, np.hypot(q, x) - geometry.array_radius
