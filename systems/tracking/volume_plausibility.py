"""Check whether a volume is plausible, before it reaches the tracker."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
)
from sonoservo.systems.signals.volume import Volume

_STRIDE = 5
"""Stride in voxels, along each axis, of the voxels that are examined."""

_WHITE = 250
"""Grey level from which a voxel counts as saturated."""

_UNRELATED = 0.1
"""Largest correlation of neighbouring voxels in noise: a beam is wider than a voxel."""

_SAME_SPACING = 1e-3
"""Relative difference of spacings that comes from rounding."""


@dataclass(kw_only=True)
class VolumePlausibilityParameters:
    """Limits within which a volume is plausible.

    Parameters
    ----------
    max_ahead
        Largest time by which a volume may be further ahead of this computer's clock than the one
        before it, in s. The first two volumes tell how the scanner's clock differs.
    max_gap
        Largest time between two volumes, in s. A volume after a longer gap is refused unless the
        next one confirms it, so one wrong time cannot blind the tracker.
    max_white
        Largest share of saturated voxels among those that are not black.
    mirror_correlation
        Correlation with the mirrored previous volume, and excess over the correlation with that
        volume itself, from which a volume counts as mirrored. Both are taken after the mean of each
        depth was removed. 1 switches the check off.
    """

    max_ahead: NotNegative = 1.0
    max_gap: Positive = 5.0
    max_white: float = 0.9
    mirror_correlation: float = 0.25

    def __post_init__(self) -> None:
        check_bounds(self)
        for name in ("max_white", "mirror_correlation"):
            value = getattr(self, name)
            require(0 < value <= 1, name, value, "above 0 and at most 1")


def is_noise(volume: Volume) -> bool:
    """Return True if neighbouring voxels are uncorrelated, as in no ultrasound image."""
    seen = volume.seen
    if not seen.any():
        return False
    levels = volume.intensities - np.mean(volume.intensities[seen], dtype=np.float64)
    variance, together = float(np.mean(levels[seen] ** 2)), []
    for axis, n in enumerate(levels.shape):
        later, earlier = range(1, n), range(n - 1)
        both = np.take(seen, later, axis) & np.take(seen, earlier, axis)
        if both.any():
            product = np.take(levels, later, axis) * np.take(levels, earlier, axis)
            together.append(float(product[both].mean()))
    return bool(together and variance > 0 and max(together) < _UNRELATED * variance)


def implausible(
    volume: Volume,
    last: Volume | None,
    refused: Volume | None,
    clock: float,
    lead: float,
    parameters: VolumePlausibilityParameters,
) -> str:
    """Return the reason why a volume cannot be believed; empty if it can.

    ``last`` is the last plausible volume, which was ``lead`` s ahead of the clock, and ``refused``
    the last one refused since, which this one may confirm. ``clock`` is the time in s; 0 if
    unknown.
    """
    if not np.isfinite(volume.X_WP.GetAsMatrix34()).all():
        return "its pose is not a number"
    sample = volume.intensities[::_STRIDE, ::_STRIDE, ::_STRIDE].copy()
    if sample.min() == sample.max() and volume.intensities.min() == volume.intensities.max():
        return "it is blank: all its voxels are equal"
    if sample.max() <= 1 and volume.intensities.max() <= 1:
        return "no grey level is above 1; they go from 0 to 255"
    if np.sum(sample >= _WHITE) > parameters.max_white * np.count_nonzero(sample):
        return "it is white: its voxels are saturated"
    confirmed = refused is not None and 0 < volume.time - refused.time <= parameters.max_gap
    ahead = volume.time - clock - lead
    if clock > 0 and ahead > parameters.max_ahead and not (last is None and confirmed):
        return f"its time is {ahead:.2f} s ahead of the clock"
    if last is None:
        return ""
    if volume.time < last.time:
        return f"its time is {last.time - volume.time:.2f} s before that of the volume before it"
    gap = volume.time - last.time
    if gap > parameters.max_gap and not confirmed:
        return f"its time is {gap:.1f} s after that of the volume before it"
    if not _same_spacing(volume, last) and not (
        refused is not None and _same_spacing(volume, refused)
    ):
        spacing = ", ".join(f"{1e3 * each:.3g}" for each in volume.spacing)
        return f"it lies on another grid, with a spacing of {spacing} mm"
    axis = mirrored_axis(volume, last, parameters.mirror_correlation)
    return f"it looks mirrored along {axis}" if axis else ""


def _same_spacing(a: Volume, b: Volume) -> bool:
    return bool(np.allclose(a.spacing, b.spacing, rtol=_SAME_SPACING, atol=0))


def mirrored_axis(volume: Volume, last: Volume, threshold: float) -> str:
    """Return "X" or "Z" if a volume resembles the mirrored previous one, or an empty text.

    Its correlation with the mirrored one must be ``threshold`` above that with the previous one
    itself and above 0. Mirroring does not show while the probe moves or if the tissue has no
    structure.
    """
    if volume.intensities.shape != last.intensities.shape or threshold >= 1:
        return ""
    now, before = _texture(volume), _texture(last)
    size = math.sqrt(np.vdot(now, now) * np.vdot(before, before))
    if size == 0:
        return ""
    least = max(0.0, float(np.vdot(now, before)) / size) + threshold
    for axis, mirrored in (("X", before[::-1]), ("Z", before[..., ::-1])):
        if np.vdot(now, mirrored) / size > least:
            return axis
    return ""


def _texture(volume: Volume) -> NDArray[np.float64]:
    """Return every `_STRIDE`-th voxel less the mean of its depth; symmetric about the middle.

    In whole grey levels, whose sums are exact.
    """
    nx, _, nz = volume.intensities.shape
    x, z = (np.unique(np.r_[i := np.arange(0, n // 2, _STRIDE), n - 1 - i]) for n in (nx, nz))
    sample, seen = (each[:, ::_STRIDE][x][..., z] for each in (volume.intensities, volume.seen))
    sample = np.trunc(sample, dtype=np.float64)
    mean = sample.sum(axis=(0, 2)) // np.maximum(seen.sum(axis=(0, 2)), 1)
    return np.where(seen, sample - mean[:, np.newaxis], 0)
