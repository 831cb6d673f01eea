"""Why no needle was found, in words, and what to change."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_logs import build_log

from sonoservo.systems.evaluation.metrics import missing_needle
from sonoservo.systems.signals.search_reason import ReasonCount, SearchReason

NONE = "there is no earlier volume to compare with"
MOVED, STILL = "the change is spread over 31 mm", "nothing changed by more than 2.1 dB"


def log(reasons, visible=0.03, inserted=0.05, measured=None):
    """Volumes every second; the needle is in view, as far as it ever is, from the third on."""
    count = len(reasons)
    time = np.arange(0, count, 1 / 32)
    return build_log(
        len(time),
        count,
        time=time,
        inserted_length=np.full(len(time), inserted),
        visible_length=np.where(time >= 2, visible, 0.0),
        volume_time=np.arange(count) + 0.5,
        volume_detection_reason=np.array(reasons),
        volume_measurement_reason=np.array(measured or [""] * count),
    )


def test_the_most_frequent_reason_while_the_needle_is_in_view_counts():
    reason, advice = missing_needle(log([NONE, MOVED, MOVED, STILL, NONE, STILL, STILL]))
    assert reason == "Nothing changed by more than 2.1 dB."
    assert advice.startswith("Push the needle into view (hand.pushes, hand.aim)")
    reason, advice = missing_needle(
        log([NONE, NONE, "the change is spread over 9 mm", NONE, MOVED, STILL])
    )
    assert reason == "The change is spread over 31 mm."
    assert "more slowly" in advice
    line = "no line stands out as a needle does"  # of a search in the whole volume
    reason, advice = missing_needle(log(["a needle is being tracked"] * 4, measured=[line] * 4))
    assert reason == "No line stands out as a needle does."
    assert "hand.dip_deg" in advice


def test_a_detection_that_is_not_confirmed_is_said_to_be_so():
    """The needle comes to rest before enough volumes show its motion."""
    fast = log([""] * 4, measured=["no needle has been detected"] * 4)
    reason, advice = missing_needle(replace(fast, volume_detected=np.ones(4, bool)))
    assert reason == "Something moved; the needle is not confirmed yet."
    assert "more slowly" in advice


@pytest.mark.parametrize(
    ("truth", "beginning", "field"),
    [
        ({"visible": 0.0}, "The needle never came into view. Nothing changed", "hand.aim"),
        ({"inserted": 0.0}, "The needle stayed outside the tissue. Nothing", "hand.start"),
    ],
)
def test_a_needle_that_could_not_be_seen_is_said_to_be_so(truth, beginning, field):
    reason, advice = missing_needle(log([NONE, STILL, STILL], **truth))
    assert reason.startswith(beginning)
    assert field in advice


def test_a_run_too_short_for_a_volume_says_so():
    assert missing_needle(build_log(0, 0)) == (
        "No volume was acquired.",
        "Let the run be longer (duration).",
    )


def test_reasons_are_counted_by_kind_the_most_frequent_first():
    count = ReasonCount(
        [MOVED, STILL, "it rains", "", STILL, "the change is spread over 9 mm", STILL]
    )
    assert count.words == {"nothing changes": 3, "too much changes at once": 2, "it rains": 1}
    assert "--start anywhere" in count.advice
    assert ReasonCount(["it rains"]).advice == ""


@pytest.mark.parametrize("kind", SearchReason)
def test_a_reason_keeps_its_kind_on_the_wire_and_in_a_log(kind):
    reason = kind(" by 3 mm")
    assert SearchReason.of(reason) is kind
    stored = np.array([reason])[0]
    assert SearchReason.of(str(stored)) is kind
    assert "hand." not in kind.track_advice
    assert SearchReason.of("it rains") is None
