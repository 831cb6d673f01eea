"""Detection of an insertion as published, with nothing added to it."""

from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.papers.chatelain2013.method.field_of_view import closest_face
from sonoservo.diagrams.papers.chatelain2013.method.geometric_median import geometric_median
from sonoservo.diagrams.papers.chatelain2013.method.volume_difference import top_differences
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.volume import Volume


@dataclass(kw_only=True)
class PublishedDetectionParameters:
    """Thresholds of Chatelain 2013, section II-B. The paper publishes no values.

    Parameters
    ----------
    candidate_volume
        Total volume of the candidate voxels, which fixes their number ``|X|``, in m^3. The paper
        chooses the number that best separates the variance of a motionless volume from that of a
        volume with a moving needle. So it was here, with figs. 4 and 5 on seeds from 100 on.
    max_std
        Square root of the variance threshold tau, in m. The variance is the trace of the
        candidates' covariance. Between sweeps of one direction, half the volumes with a moving
        needle are below 24 mm, and no motionless one is below 34 mm.
    max_depth
        Largest distance delta from the geometric median to the candidate entry point, in m.
    """

    candidate_volume: float = 5e-9
    max_std: float = 27e-3
    max_depth: float = 10e-3

    def __post_init__(self) -> None:
        require_positive(
            candidate_volume=self.candidate_volume, max_std=self.max_std, max_depth=self.max_depth
        )


def detect_as_published(
    volume: Volume,
    previous: Volume,
    parameters: PublishedDetectionParameters,
) -> InsertionDetection | NotFound:
    """Detect an insertion as Chatelain 2013, section II-B describes it, or say why there is none.

    Eq. 1 gives the voxels whose absolute difference is at least T_t, the order statistic that fixes
    their number. Their variance must be below tau. The geometric median (eq. 2) is projected on the
    closest face of the volume's boundary. The entry point counts if it is closer than delta. The
    tip of the detection is the median, as the paper does not estimate one. Volumes between which
    the probe moved by more than a voxel are not compared, as the paper's difference holds for a
    static probe only; ours lands on the phantom first.
    """
    if volume.intensities.shape != previous.intensities.shape:
        return NotFound("the previous volume lies on another grid")
    if _moved(volume, previous) > float(volume.spacing.max()):
        return NotFound("the probe moved between the volumes")
    count = max(4, round(parameters.candidate_volume / float(np.prod(volume.spacing))))
    # Sweeps to and fro see slightly unlike sectors; only voxels that both show are compared.
    seen = volume.seen, previous.seen
    index, threshold = top_differences(volume.intensities, previous.intensities, count, seen=seen)
    if len(index) < 4:
        return NotFound("nothing changed")
    p_P = volume.position(index)
    std = float(np.sqrt(p_P.var(axis=0).sum()))
    if std > parameters.max_std:
        return NotFound(f"the change is spread over {1e3 * std:.1f} mm")
    median = geometric_median(p_P)
    entry = closest_face(volume, median)
    depth = float(np.linalg.norm(entry - median))
    if depth > parameters.max_depth:
        return NotFound(f"the change lies {1e3 * depth:.1f} mm inside the field of view")
    p_W, _ = volume.at_once().to_world(np.stack([entry, median]))
    change = threshold * volume.decibels_per_level
    return InsertionDetection(p_W[0], p_W[1], p_W[1], std, change, volume.time)


def _moved(volume: Volume, previous: Volume) -> float:
    """Return the farthest that a corner of the volume's grid moved with the probe, in m."""
    corners = np.stack(np.meshgrid(*zip(volume.origin, volume.upper, strict=True)), axis=-1)
    p_P = corners.reshape(-1, 3).T
    apart = volume.X_WP.multiply(p_P) - previous.X_WP.multiply(p_P)
    return float(np.linalg.norm(apart, axis=0).max())
