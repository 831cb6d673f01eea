"""Localization in one volume: around a prediction, or anywhere."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.needle_line import lie_along, needle_lines
from sonoservo.systems.tracking.region_localization import localize_in_region
from sonoservo.systems.tracking.search_region import (
    line_region,
    narrow_region,
    predicted_region,
)
from sonoservo.systems.tracking.volume_plausibility import is_noise

_REPEATS = 7
"""Number of searches along a line found without a prediction; the one nearest the median counts."""

_SURER = 2.0
"""Factor on the smallest evidence in a narrow region, where any line agrees with the prediction."""

Floats = NDArray[np.float64]
Attempts = list[LocalizationAttempt]


def localize(
    volume: Volume,
    prediction: NeedlePrediction | NotFound,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> NeedleMeasurement | NotFound:
    """Localize the needle in a volume (Chatelain 2013, section II-D).

    Parameters
    ----------
    volume
        Volume to search.
    prediction
        Prediction that selects the search region; a `NotFound` is returned unchanged.
    parameters
        Search regions and thresholds.
    rng
        Generator that draws the samples.

    Returns
    -------
    The measurement in W, or a `NotFound` with the reason why there is none.
    """
    return explain_localization(volume, prediction, parameters, rng).measurement


def explain_localization(
    volume: Volume,
    prediction: NeedlePrediction | NotFound,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> LocalizationExplanation:
    """Localize the needle as `localize` does, and return all intermediate results."""
    attempts: Attempts = []
    probability = 0.0
    if not parameters.sweep_time:
        volume = volume.at_once()
    if isinstance(prediction, NotFound):
        measurement: NeedleMeasurement | NotFound = prediction
    elif prediction.found:
        assert prediction.curve is not None
        attempts, measurement = _localize_along(volume, prediction.curve, parameters, rng)
    elif prediction.everywhere:
        attempts, measurement, probability = _localize_everywhere(
            volume, prediction.order, parameters, rng
        )
    else:
        region = predicted_region(prediction, parameters)
        attempts = localize_in_region(volume, region, parameters, rng)
        limited = parameters.volume_of_interest and parameters.angle_gate
        if not attempts[-1].measurement and limited:
            narrow = narrow_region(region, parameters)
            surer = replace(parameters, min_evidence=_SURER * parameters.min_evidence)
            attempts += localize_in_region(volume, narrow, surer, rng)
        measurement = attempts[-1].measurement
    return LocalizationExplanation(
        volume.time, prediction, tuple(attempts), measurement, probability
    )


def _localize_everywhere(
    volume: Volume,
    order: int,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> tuple[Attempts, NeedleMeasurement | NotFound, float]:
    """Localize the line that looks most like a needle; return the probability that it is one."""
    if is_noise(volume):
        return [], NotFound(SearchReason.NO_LINE(" stands out of what is noise")), 0.0
    lines = needle_lines(volume)
    if not lines:
        return [], NotFound(SearchReason.NO_BRIGHT_LINE(" is seen")), 0.0
    if lines[0].probability < parameters.min_probability:
        reason = SearchReason.NO_LINE(" stands out as a needle does")
        return [], NotFound(reason), lines[0].probability
    attempts: Attempts = []
    first: tuple[NotFound, float] | None = None
    for each in lines:
        if each.probability < parameters.min_probability:
            break
        ends = volume.to_world(each.ends)[0]
        line = NeedleCurve(np.linspace(ends[0], ends[1], order))
        more, measurement = _localize_along(volume, line, parameters, rng)
        attempts += more
        if isinstance(measurement, NotFound):
            first = first or (measurement, 0.0)
            continue
        # The measurement must lie along the line that was found.
        seen = acquired_from(volume, measurement.curve.control_points[[0, -1]])
        if lie_along(each.ends[np.newaxis], seen[np.newaxis])[0, 0]:
            return attempts, measurement, each.probability
        reason = SearchReason.NOT_ALIKE(" is not what was measured along it")
        first = first or (NotFound(reason), each.probability)
    assert first is not None
    return attempts, *first


def _localize_along(
    volume: Volume,
    line: NeedleCurve,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> tuple[Attempts, NeedleMeasurement | NotFound]:
    """Localize the needle along a line that was found in the volume itself.

    The beam makes a short needle look thick, so its axis varies with the random draws.
    """
    region = line_region(line, parameters)
    attempts = localize_in_region(volume, region, parameters, rng, _REPEATS)
    return attempts, _middlemost([each.measurement for each in attempts])


def _middlemost(found: Sequence[NeedleMeasurement | NotFound]) -> NeedleMeasurement | NotFound:
    """Return the measurement nearest to the median, if most searches found a needle."""
    measured = [each for each in found if isinstance(each, NeedleMeasurement)]
    if 2 * len(measured) <= len(found):
        return next(each for each in found if isinstance(each, NotFound))
    points = np.array([each.curve.control_points for each in measured])
    away = np.linalg.norm(points - np.median(points, axis=0), axis=-1).sum(axis=-1)
    return measured[int(away.argmin())]
