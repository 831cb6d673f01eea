"""Detection of a needle that enters the field of view."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.detection.field_of_view import closest_side
from sonoservo.systems.detection.geometric_median import geometric_median
from sonoservo.systems.detection.motion_compensation import compensate_motion
from sonoservo.systems.detection.volume_difference import top_differences
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.ports import evaluate, evaluate_port
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume

_TIP_QUANTILE = 0.85
"""Quantile of the distances from the entry beyond which a stretched change is the needle's tip;
a compact change is halved."""

_LEAST_EARLIER = 2
"""Number of earlier volumes, besides the previous one, that show how the tissue comes and goes."""


@dataclass(kw_only=True)
class InsertionDetectorParameters:
    """Criteria by which a change between two volumes counts as an insertion.

    The paper publishes none of these values.

    Parameters
    ----------
    candidate_volume
        Total volume of the candidate voxels ``|X|``, in m^3.
    max_std
        Square root of the variance threshold tau, in m. It is compared with the root of the trace
        of the candidates' covariance.
    max_stretched_std
        The same for voxels along a line, as a fast needle leaves them, in m. 0 is the paper's form.
    max_depth
        Largest distance delta from the side of the field of view to the median, in m. A needle that
        no scan line meets at a right angle near the side stands out only further inside.
    min_change
        Smallest difference T_t of the candidates that counts as motion, in dB; less is noise.
    min_brightening
        The same for voxels that are brighter than in all earlier volumes, in dB.
    floor_quantile
        Quantile of the volume's intensities below which all intensities count as equally dark. 0 is
        the paper's form.
    reach
        Displacement of the tissue that does not count as a change, in m. 0 is the paper's form.
    stillness
        Largest displacement of a voxel in W at which the probe counts as still between two volumes,
        in m.
    max_motion
        Largest displacement of a voxel in W that is compensated, in m. 0 is the paper's form.
    min_correlation
        Smallest correlation of a volume with the previous one after the probe moved.
    """

    candidate_volume: float = 5e-9
    max_std: float = 6e-3
    max_stretched_std: float = 15e-3
    max_depth: float = 20e-3
    min_change: float = 4.5
    min_brightening: float = 3.0
    floor_quantile: float = 0.9
    reach: float = 0.7e-3
    stillness: float = 0.3e-3
    max_motion: float = 10e-3
    min_correlation: float = 0.5

    def __post_init__(self) -> None:
        require_positive(
            candidate_volume=self.candidate_volume,
            max_std=self.max_std,
            max_depth=self.max_depth,
            stillness=self.stillness,
        )
        require_not_negative(
            min_change=self.min_change,
            min_brightening=self.min_brightening,
            reach=self.reach,
            max_motion=self.max_motion,
            max_stretched_std=self.max_stretched_std,
            min_correlation=self.min_correlation,
        )
        require(self.min_correlation < 1, "min_correlation", self.min_correlation, "below 1")
        require(
            0 <= self.floor_quantile < 1, "floor_quantile", self.floor_quantile, "from 0 to below 1"
        )


def max_motion(current: Volume, previous: Volume) -> float:
    """Return the largest distance in m by which a corner of the volume moved in W."""
    corners = np.array(np.meshgrid(*zip(current.origin, current.upper, strict=True))).reshape(3, -1)
    corners = np.vstack([corners, np.ones(corners.shape[1])])
    if current.motion is None or previous.motion is None:
        poses = current.X_WP.GetAsMatrix4() - previous.X_WP.GetAsMatrix4()
    else:
        poses = current.motion.X_WP - previous.motion.X_WP
    return float(np.linalg.norm((poses @ corners)[..., :3, :], axis=-2).max())


def _floor(volume: Volume, quantile: float) -> float:
    """Return a quantile of the intensities in the field of view, from every 27th voxel."""
    sample = volume.intensities[::3, ::3, ::3][volume.seen[::3, ::3, ::3]]
    if quantile == 0 or sample.size == 0:
        return 0.0
    return float(np.quantile(sample, quantile, method="lower"))


def _is_stretched(p_P: NDArray[np.float64], parameters: InsertionDetectorParameters) -> bool:
    """Return True if voxels lie along a line, as those of a needle that moved fast do."""
    *across, along = np.linalg.eigvalsh(np.cov(p_P.T))
    narrow = bool(sum(across) <= (parameters.max_std / 2) ** 2)
    return narrow and bool(along <= parameters.max_stretched_std**2)


def _std(p_P: NDArray[np.float64]) -> float:
    """Return the square root of the trace of the covariance of places, in m."""
    return float(np.sqrt(p_P.var(axis=0).sum()))


def _spread(p_P: NDArray[np.float64], parameters: InsertionDetectorParameters) -> float:
    """Return the standard deviation in m of changes that are far apart; 0 if they are not."""
    std = _std(p_P)
    return 0.0 if std <= parameters.max_std or _is_stretched(p_P, parameters) else std


def _outer_end(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the end of a stretched change that is closer to a side of the field of view."""
    along = (p_P - p_P.mean(axis=0)) @ np.linalg.eigh(np.cov(p_P.T))[1][:, -1]
    most = np.quantile(along, [1 - _TIP_QUANTILE, _TIP_QUANTILE])
    ends = [geometric_median(p_P[far]) for far in (along <= most[0], along >= most[1])]
    return min(ends, key=lambda end: float(np.linalg.norm(closest_side(volume, end) - end)))


def _comparable(volume: Volume, previous: Volume) -> NotFound | None:
    """Return why two volumes cannot be compared voxel by voxel; None if they can."""
    if volume.intensities.shape != previous.intensities.shape or not (
        np.allclose(volume.origin, previous.origin)
        and np.allclose(volume.spacing, previous.spacing)
    ):
        return NotFound("the previous volume lies on another grid")
    if volume.decibels_per_level != previous.decibels_per_level:
        return NotFound("the previous volume has another scale of grey levels")
    return None


def _aligned(
    volume: Volume, previous: Volume, parameters: InsertionDetectorParameters
) -> Volume | NotFound:
    """Return the previous volume as the probe would have seen it from where it is now."""
    motion = max_motion(volume, previous)
    if motion > max(parameters.stillness, parameters.max_motion):
        return NotFound(f"the probe moved {1e3 * motion:.2f} mm between the volumes")
    if motion <= parameters.stillness:
        return previous
    aligned = compensate_motion(volume, previous, parameters.min_correlation)
    return aligned or NotFound(f"the tissue changed while the probe moved {1e3 * motion:.2f} mm")


def _background(
    volume: Volume, earlier: Sequence[Volume], parameters: InsertionDetectorParameters
) -> Volume | None:
    """Return the brightest that each voxel was in earlier volumes; None if there are too few."""
    comparable = [each for each in earlier if _comparable(volume, each) is None]
    aligned = [_aligned(volume, each, parameters) for each in comparable]
    past = [each for each in aligned if isinstance(each, Volume)]
    if len(past) < 1 + _LEAST_EARLIER:
        return None
    return replace(
        volume,
        intensities=np.maximum.reduce([each.intensities for each in past]),
        mask=np.logical_or.reduce([each.seen for each in past]),
    )


def _changed_voxels(
    volume: Volume,
    previous: Volume,
    parameters: InsertionDetectorParameters,
    *,
    both_seen: bool,
    brighter_only: bool = False,
) -> tuple[NDArray[np.float64], float]:
    """Return the places of the `top_differences` in P, in m, and the smallest of them in dB."""
    count = max(4, round(parameters.candidate_volume / float(np.prod(volume.spacing))))
    index, threshold = top_differences(
        volume.intensities,
        previous.intensities,
        count,
        floor=_floor(volume, parameters.floor_quantile),
        reach=round(parameters.reach / float(volume.spacing.mean())),
        seen=(volume.seen, previous.seen) if both_seen else None,
        brighter_only=brighter_only,
    )
    change = threshold * volume.decibels_per_level
    return volume.position(index), change if len(index) >= count else min(change, 0.0)


def detect_insertion(
    volume: Volume,
    previous: Volume,
    parameters: InsertionDetectorParameters,
    earlier: Sequence[Volume] = (),
) -> InsertionDetection | NotFound:
    """Find the place at which a needle entered between two volumes (Chatelain 2013, section II-B).

    If the change is spread, as it is in tissue that breathes or pulsates, only that counts which is
    brighter than in all earlier volumes.

    Parameters
    ----------
    volume, previous
        Volumes on the same grid.
    parameters
        Thresholds.
    earlier
        Volumes from the seconds before the previous one.

    Returns
    -------
    The detection in W, or a `NotFound` with the reason why there is none.
    """
    if (reason := _comparable(volume, previous)) is not None:
        return reason
    aligned = _aligned(volume, previous, parameters)
    if isinstance(aligned, NotFound):
        return aligned
    # Sweeps in opposite directions see slightly different sectors, whose edges are no change.
    unlike = max_motion(volume, previous) > parameters.stillness or (
        volume.motion is not None
        and previous.motion is not None
        and volume.motion.direction != previous.motion.direction
    )
    least = parameters.min_change
    p_P, change = _changed_voxels(volume, aligned, parameters, both_seen=unlike)
    if change >= least and _spread(p_P, parameters):
        background = _background(volume, [aligned, *earlier], parameters)
        if background is not None:
            least = parameters.min_brightening
            p_P, change = _changed_voxels(
                volume, background, parameters, both_seen=True, brighter_only=True
            )
    if change < least:
        return NotFound(f"nothing changed by more than {change:.1f} dB")
    if (std := _spread(p_P, parameters)) > 0:
        return NotFound(f"the change is spread over {1e3 * std:.1f} mm")
    long = _std(p_P) > parameters.max_std
    median = geometric_median(p_P)
    outer = _outer_end(volume, p_P) if long else median
    entry = closest_side(volume, outer)
    depth = float(np.linalg.norm(entry - outer))
    if depth > parameters.max_depth:
        return NotFound(f"the change lies {1e3 * depth:.1f} mm inside the field of view")
    away = np.linalg.norm(p_P - entry, axis=1)
    tip = geometric_median(p_P[away >= np.quantile(away, _TIP_QUANTILE if long else 0.5)])
    p_W, times = volume.to_world(np.stack([entry, median, tip]))
    return InsertionDetection(p_W[0], p_W[1], p_W[2], _std(p_P), change, float(times[2]))


class InsertionDetector(LeafSystem):
    """Detects a needle's insertion from the difference of two volumes.

    .. pydrake_system::

        name: InsertionDetector
        input_ports:
        - volume
        - previous_volume
        - earlier_volumes (optional)
        output_ports:
        - detection

    The system has no state. The variance of the voxels that changed most (Chatelain 2013, eq. 1)
    distinguishes a local motion from a global one. Their geometric median (eq. 2), projected on the
    closest side of the field of view, gives the entry point. The output is an `InsertionDetection`,
    or a `NotFound` with the reason why there is none. Motion of the probe is compensated.

    Parameters
    ----------
    parameters
        Thresholds of the method, in SI units.
    method
        Function that compares two volumes, with the arguments of `detect_insertion`.
    """

    def __init__(
        self,
        *,
        parameters: Any = None,
        method: Callable[..., InsertionDetection | NotFound] = detect_insertion,
    ) -> None:
        super().__init__()
        self._parameters = parameters or InsertionDetectorParameters()
        self._method = method
        self.DeclareAbstractInputPort("volume", Value[object]())
        self.DeclareAbstractInputPort("previous_volume", Value[object]())
        self._earlier = self.DeclareAbstractInputPort("earlier_volumes", Value[object]())
        self.DeclareAbstractOutputPort("detection", lambda: Value[object](), self._calc_detection)

    def _calc_detection(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        previous = evaluate(self, context, "previous_volume", (Volume, NotFound))
        if not isinstance(volume, Volume):
            output.set_value(volume)
        elif not isinstance(previous, Volume):
            output.set_value(previous)
        else:
            earlier: tuple[Volume, ...] = ()
            if self._earlier.HasValue(context):
                earlier = evaluate_port(self._earlier, context, tuple)
            output.set_value(self._method(volume, previous, self._parameters, earlier))
