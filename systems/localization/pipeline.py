"""Localization in one volume: around a prediction, or anywhere."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.localization.needle_line import NeedleLine, line_between, needle_lines
from sonoservo.systems.localization.novelty import THERE_BEFORE, has_moved, is_new
from sonoservo.systems.localization.region_localization import localize_in_region
from sonoservo.systems.localization.search_region import (
    found_again,
    line_region,
    narrow_region,
    predicted_region,
)
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
)
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.volume import Volume

_REPEATS = 7
"""Number of searches around a line without a prediction; the result nearest the median counts."""

_SURER = 2.0
"""Factor on the smallest evidence in a narrow region, where anything agrees with the prediction."""

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
    elif not prediction.everywhere:
        region = predicted_region(prediction, parameters)
        attempts = localize_in_region(volume, region, parameters, rng)
        limited = parameters.volume_of_interest and parameters.angle_gate
        if not attempts[-1].measurement and region.entry is not None and limited:
            narrow = narrow_region(region, parameters)
            surer = replace(parameters, min_evidence=_SURER * parameters.min_evidence)
            attempts += localize_in_region(volume, narrow, surer, rng)
        measurement = attempts[-1].measurement
        if region.tip_moved and isinstance(measurement, NeedleMeasurement):
            measurement = _if_needle(volume, measurement, prediction, parameters)
    else:
        attempts, measurement, log_odds = _localize_everywhere(volume, prediction, parameters, rng)
        probability = float(expit(log_odds))
    return LocalizationExplanation(
        volume.time, prediction, tuple(attempts), measurement, probability
    )


def _localize_everywhere(
    volume: Volume,
    prediction: NeedlePrediction,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> tuple[Attempts, NeedleMeasurement | NotFound, float]:
    """Localize a needle that was lost or never seen, and return the logarithm of its odds."""
    last = prediction.curve

    def odds(line: NeedleLine) -> tuple[float, Floats, bool]:
        """Return the logarithm of a line's odds, its ends in W, and whether it is where it was."""
        ends = volume.to_world(line.ends)[0]
        if last is None:
            return line.log_odds, ends, False
        log_odds, ends = found_again(line.log_odds, ends, last)
        return log_odds, ends, log_odds >= line.log_odds

    lines = sorted(map(odds, needle_lines(volume)), key=lambda each: -each[0])
    if not lines:
        return [], NotFound("no bright line comes from outside the field of view"), -np.inf
    probable = [each for each in lines if expit(each[0]) >= parameters.min_probability]
    if not probable:
        reason = "no line stands out from its surroundings as a needle does"
        if last is not None:
            reason = "no line looks like the needle that was lost"
        return [], NotFound(reason), lines[0][0]
    earlier, must_come = prediction.earlier, prediction.must_come
    new = (each for each in probable if each[2] or is_new(volume, each[1], earlier, must_come))
    attempts: Attempts = []
    first: tuple[NotFound, float] | None = None
    for log_odds, ends, there in new:
        # The beam makes a short needle look thick, so its axis varies with the random draws.
        region = line_region(ends, prediction.order, parameters)
        repeats = [localize_in_region(volume, region, parameters, rng) for _ in range(_REPEATS)]
        attempts += [attempt for each in repeats for attempt in each]
        measurement = _middlemost([each[-1].measurement for each in repeats])
        if isinstance(measurement, NotFound):
            first = first or (measurement, -np.inf)
            continue
        # What was measured must look like a needle, too, over all its length, and be new, too.
        measured = _line_of(volume, measurement)
        if measured is None or odds(measured)[0] < 0:
            reason = "the line found does not look like a needle over all its length"
            first = first or (NotFound(reason), log_odds)
        elif there or is_new(volume, _ends(measurement), earlier, must_come):
            return attempts, measurement, log_odds
        else:
            first = first or (NotFound(THERE_BEFORE), log_odds)
    return attempts, *(first or (NotFound(THERE_BEFORE), -np.inf))


def _if_needle(
    volume: Volume,
    measurement: NeedleMeasurement,
    prediction: NeedlePrediction,
    parameters: NeedleLocalizerParameters,
) -> NeedleMeasurement | NotFound:
    """Return the measurement of what moved, unless it clearly is a sheet or did not come.

    Where its looks cannot tell, as while it is too short, its motion must do.
    """
    line = _line_of(volume, measurement)
    if line is not None and -np.inf < line.log_odds < parameters.min_odds:
        return NotFound("what moved does not look like a needle")
    ends, earlier = _ends(measurement), prediction.earlier
    moved = has_moved(volume, ends, earlier, prediction.must_come)
    if not (moved or is_new(volume, ends, earlier, must_come=True)):
        return NotFound(THERE_BEFORE)
    return measurement


def _line_of(volume: Volume, measurement: NeedleMeasurement) -> NeedleLine | None:
    """Return the line between a measured needle's ends; None if it lies outside the view."""
    return line_between(volume, acquired_from(volume, _ends(measurement)))


def _ends(measurement: NeedleMeasurement) -> Floats:
    """Return the (2, 3) ends of a measured needle in W, in m."""
    return measurement.curve.control_points[[0, -1]]


def _middlemost(found: Sequence[NeedleMeasurement | NotFound]) -> NeedleMeasurement | NotFound:
    """Return the measurement nearest to the median, if most searches found a needle."""
    measured = [each for each in found if isinstance(each, NeedleMeasurement)]
    if 2 * len(measured) <= len(found):
        return next(each for each in found if isinstance(each, NotFound))
    points = np.array([each.curve.control_points for each in measured])
    away = np.linalg.norm(points - np.median(points, axis=0), axis=-1).sum(axis=-1)
    return measured[int(away.argmin())]
