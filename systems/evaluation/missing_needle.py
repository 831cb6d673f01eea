"""Reason why a run's tracker found no needle, and what to change."""

from collections import Counter

import numpy as np

from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.search_reason import SearchReason

_IN_VIEW = 5e-3
"""Length of the needle in the swept sector, in m, from which the tracker could find it."""


def missing_needle(log: RunLog) -> tuple[str, str]:
    """Return why the tracker found no needle, and what to change, each as a sentence or empty.

    It is the most frequent reason while the needle could be seen, in truth, or in the whole run.
    """
    reasons = volume_reasons(log)
    if not reasons:
        return "No volume was acquired.", _sentence(SearchReason.NO_VOLUME.run_advice)
    last = f" {_sentence(reasons[-1])}" if reasons[-1] else ""
    if np.nanmax(log.inserted_length, initial=-1) == 0:
        return (
            f"The needle stayed outside the tissue.{last}",
            "Push it in before the run ends (hand.start, hand.pushes, duration).",
        )
    visible = at_times(log, log.visible_length, log.volume_time)
    seen = np.nan_to_num(visible) > _IN_VIEW
    if np.isfinite(visible).any() and not seen.any():
        return (
            f"The needle never came into view.{last}",
            "Push it further (hand.pushes), or let it pass below the probe (hand.aim).",
        )
    shown = [reason for reason, each in zip(reasons, seen, strict=True) if each] or reasons
    # The first volumes have nothing to be compared with, whatever else is wrong.
    early = SearchReason.NOTHING_EARLIER
    shown = [each for each in shown if SearchReason.of(each) is not early] or shown
    counts = Counter(SearchReason.of(each) or each for each in shown)
    usual, _ = counts.most_common(1)[0]
    last = next(each for each in reversed(shown) if (SearchReason.of(each) or each) == usual)
    return _sentence(last), _sentence(usual.run_advice if isinstance(usual, SearchReason) else "")


def volume_reasons(log: RunLog) -> list[str]:
    """Return for each volume of a log why it gave no needle; empty if nothing was said."""
    given = log.volume_detected, log.volume_detection_reason, log.volume_measurement_reason
    return [_reason(*each) for each in zip(*(column.tolist() for column in given), strict=True)]


def _reason(is_detected: bool, detection: str, measurement: str) -> str:
    """Return the reason of one volume, from those of the detector and the localizer."""
    measured, detected = SearchReason.of(measurement), SearchReason.of(detection)
    if is_detected and measured is SearchReason.NOT_DETECTED:
        return SearchReason.MOTION_UNCONFIRMED("; the needle is not confirmed yet")
    nothing_said = not detection or detected is SearchReason.TRACKED
    return measurement if nothing_said else detection


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""
