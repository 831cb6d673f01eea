"""How far the needle reaches along its axis."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sonoservo.systems.localization.axis import Axis
from sonoservo.systems.localization.candidates import acquired_from
from sonoservo.systems.ultrasound.volume import Volume
from sonoservo.systems.values import (
    Immutable,
    NotFound,
    read_only,
    require_not_negative,
    require_positive,
)


@dataclass(kw_only=True)
class TipParameters:
    """How the needle's extent is read off the intensity along its axis.

    Parameters
    ----------
    step
        Between samples along the axis, in m.
    tube_radius
        Of the tube whose maximum counts, in m.
    background_radius
        At which tubes around the axis show the background, in m.
    contrast
        By which the needle stands out from the background, in dB.
    smoothing
        Length over which the contrast is averaged, in m.
    largest_gap
        That is bridged, in m.
    drop
        From the shaft's level to the tip's, in dB: a coherent edge blurred by a symmetric beam has
        lost half its amplitude, 6 dB, where the needle ends.
    level_length
        Length of shaft behind the tip that gives its level, in m.
    decibels_per_level
        dB per unit of a voxel's intensity.
    """

    step: float = 0.25e-3
    tube_radius: float = 1.0e-3
    background_radius: float = 5e-3
    contrast: float = 8.0
    smoothing: float = 1.5e-3
    largest_gap: float = 3e-3
    drop: float = 6.0
    level_length: float = 5e-3
    decibels_per_level: float = 60 / 255

    def __post_init__(self) -> None:
        require_positive(
            step=self.step,
            tube_radius=self.tube_radius,
            background_radius=self.background_radius,
            contrast=self.contrast,
            smoothing=self.smoothing,
            drop=self.drop,
            level_length=self.level_length,
            decibels_per_level=self.decibels_per_level,
        )
        require_not_negative(largest_gap=self.largest_gap)


@njit(cache=True, nogil=True, error_model="numpy")
def _tube_maxima(  # pragma: no cover - compiled
    intensities: Any, origin: Any, spacing: Any, centres: Any, offsets: Any
) -> Any:
    """Largest trilinear sample among `offsets` around each of (m, 3) centres; -1 off the grid."""
    nx, ny, nz = intensities.shape
    maxima = np.full(centres.shape[0], -1.0)
    for m in range(centres.shape[0]):
        for q in range(offsets.shape[0]):
            x = (centres[m, 0] + offsets[q, 0] - origin[0]) / spacing[0]
            y = (centres[m, 1] + offsets[q, 1] - origin[1]) / spacing[1]
            z = (centres[m, 2] + offsets[q, 2] - origin[2]) / spacing[2]
            if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1):
                continue
            i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
            x, y, z = x - i, y - j, z - k
            value = 0.0
            for di in range(2):
                for dj in range(2):
                    for dk in range(2):
                        weight = (x if di else 1 - x) * (y if dj else 1 - y) * (z if dk else 1 - z)
                        value += weight * float(intensities[i + di, j + dj, k + dk])
            maxima[m] = max(maxima[m], value)
    return maxima


@dataclass(frozen=True, eq=False)
class AxisProfile(Immutable):
    """Intensity along an axis.

    Parameters
    ----------
    a
        (m,) abscissae in m, evenly spaced.
    level, background
        (m,) maximum in a tube around the axis, and the same beside it, in dB.
    seen
        (m,) whether the axis lies in the field of view.
    """

    a: NDArray[np.float64]
    level: NDArray[np.float64]
    background: NDArray[np.float64]
    seen: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name in ("a", "level", "background"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, (None,)))


def axis_profile(
    volume: Volume, axis: Axis, start: float, stop: float, parameters: TipParameters
) -> AxisProfile:
    """Sample the intensity along an axis.

    Parameters
    ----------
    volume
        To sample.
    axis
        In W, in m.
    start, stop
        Abscissae in m.
    parameters
        Of the tube and the background.
    """
    a = np.arange(start, stop + parameters.step, parameters.step)
    p_P = acquired_from(volume, axis.position(a))
    # A plane across the needle: the curve bends too little for each point to need its own.
    along = volume.X_WP.rotation().matrix().T @ axis.direction
    across = np.linalg.svd(along[np.newaxis])[2][1:]
    hexagon = np.array([[np.cos(t), np.sin(t)] for t in np.arange(6) * np.pi / 3])
    half = 0.5 * hexagon @ np.array([[0.866, 0.5], [-0.5, 0.866]])
    disc = parameters.tube_radius * np.vstack([np.zeros((1, 2)), half, hexagon]) @ across
    octagon = np.array([[np.cos(t), np.sin(t)] for t in np.arange(8) * np.pi / 4])
    ring = parameters.background_radius * octagon @ across
    centres = np.concatenate([p_P[np.newaxis], p_P + ring[:, np.newaxis]])
    maxima = _tube_maxima(
        volume.intensities, volume.origin, volume.spacing, centres.reshape(-1, 3), disc
    ).reshape(len(centres), len(a))
    inside = np.all((p_P >= volume.origin) & (p_P <= volume.upper), axis=1)
    if volume.motion is not None:
        inside &= volume.motion.geometry.contains(p_P)
    seen = inside & (maxima[0] >= 0)
    # Positions beside the axis that fall outside the sector say nothing about the background.
    beside = np.where(maxima[1:] > 0, maxima[1:], np.nan)
    beside[0, np.all(np.isnan(beside), axis=0)] = 0.0
    return AxisProfile(
        a,
        maxima[0].clip(0) * parameters.decibels_per_level,
        np.nanmedian(beside, axis=0) * parameters.decibels_per_level,
        seen,
    )


@dataclass(frozen=True)
class NeedleExtent(Immutable):
    """From where to where a needle is visible along its axis.

    Parameters
    ----------
    start, tip
        Abscissae in m.
    leaves
        Whether the needle leaves the field of view, so that its tip is not seen.
    contrast
        Mean contrast between start and tip, in dB.
    visible
        Share of the length between start and tip that stands out.
    """

    start: float
    tip: float
    leaves: bool
    contrast: float
    visible: float


def find_extent(
    profile: AxisProfile, parameters: TipParameters, near: float | None = None
) -> NeedleExtent | NotFound:
    """Find where a needle begins and ends along its axis (Chatelain 2013, end of section II-D).

    The needle is the longest stretch that stands out from the background, with gaps bridged. Its
    tip is where the intensity has finally dropped from the level of the shaft just behind it.

    Parameters
    ----------
    profile
        Along the axis.
    parameters
        Thresholds.
    near
        Abscissa in m which the needle is known to reach or begin near; None if not known.
    """
    step = float(profile.a[1] - profile.a[0])
    width = max(1, round(parameters.smoothing / step))
    contrast = uniform_filter1d(profile.level - profile.background, width, mode="nearest")
    stands_out = (contrast >= parameters.contrast) & profile.seen
    runs = _runs(stands_out, round(parameters.largest_gap / step))
    if not runs:
        return NotFound("nothing along the axis stands out from the background")
    first, last = max(runs, key=lambda run: run[1] - run[0])
    leaves = not profile.seen[min(last + width, len(profile.a) - 1)] or last + width >= len(
        profile.a
    )
    tip = float(profile.a[last])
    if not leaves:
        tip = _drop(profile, parameters, first, last, step)
    inside = slice(first, last + 1)
    return NeedleExtent(
        float(profile.a[first]),
        tip,
        bool(leaves),
        float(contrast[inside].mean()),
        float(stands_out[inside].mean()),
    )


def _runs(mask: NDArray[np.bool_], gap: int) -> list[tuple[int, int]]:
    """First and last index of every run of True, with gaps of up to `gap` samples bridged."""
    on = np.flatnonzero(mask)
    if len(on) == 0:
        return []
    breaks = np.flatnonzero(np.diff(on) > gap + 1)
    return list(zip(on[np.r_[0, breaks + 1]], on[np.r_[breaks, len(on) - 1]], strict=True))


def _drop(
    profile: AxisProfile, parameters: TipParameters, first: int, last: int, step: float
) -> float:
    """Abscissa where the intensity falls for the last time, from the level just behind, in m."""
    behind = max(first, last - round(parameters.level_length / step))
    level = float(np.quantile(profile.level[behind : last + 1], 0.6))
    threshold = level - parameters.drop
    beyond = min(last + round(parameters.largest_gap / step), len(profile.a) - 1)
    above = np.flatnonzero(profile.level[behind : beyond + 1] >= threshold) + behind
    if len(above) == 0:
        return float(profile.a[last])
    at = int(above[-1])
    if at + 1 >= len(profile.a):
        return float(profile.a[at])
    here, after = profile.level[at], profile.level[at + 1]
    return float(profile.a[at] + step * (here - threshold) / max(here - after, 1e-9))
