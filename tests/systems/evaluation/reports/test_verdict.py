from dataclasses import replace

import numpy as np
import pytest

from sonoservo.systems.evaluation import summarize
from sonoservo.systems.evaluation.reports.key_frames import (
    key_volumes,
    plot_key_frames,
    true_needle,
)
from sonoservo.systems.evaluation.reports.verdict import following_verdict, recording_verdict
from sonoservo.systems.evaluation.success import succeeds


@pytest.fixture
def summary(insertion_log):
    return summarize(insertion_log)


def test_a_good_run_says_what_was_reached(summary):
    verdict = following_verdict(summary)
    assert verdict.grade == "good"
    assert verdict.headline == "The needle was found and followed"
    assert "tracked in 52 of the 52 volumes" in verdict.text
    assert "less than 0.50 mm from the true one" in verdict.text
    summary["tracking"]["axis_error_deg"]["median"] = 2.77
    assert "the needle's axis was 2.8 deg off (median)" in following_verdict(summary).text
    assert "0.00 mm beside the probe's middle (X)" in verdict.text
    still = following_verdict(summary, follows=False)
    assert still.headline == "The needle was found and tracked"
    assert "(X)" not in still.text


@pytest.mark.parametrize(
    ("block", "figures", "grade", "words"),
    [
        ("tracking", {"lost_events": 2}, "mixed", "followed, and lost twice on the way"),
        ("tracking", {"wrong_s": 3.1}, "mixed", "and something else was taken for it for 3.1 s"),
        ("success", {"success": False}, "mixed", "found and kept, but not accurately"),
        ("success", {"kept": False}, "bad", "The needle was found, not kept."),
        ("success", {"found": False}, "bad", "No needle was found."),
        ("guard", {"stopped_at_end": "force"}, "bad", "The guard stopped the robot because force"),
        ("force", {"touched": False}, "bad", "The probe never touched the body"),
    ],
)
def test_what_went_wrong_comes_first(summary, block, figures, grade, words):
    summary[block] |= figures
    verdict = following_verdict(summary)
    assert succeeds(summary) == (block == "tracking")
    assert verdict.grade == grade
    assert words in str(verdict)


def test_one_volume_has_no_percentiles(summary):
    summary["tracking"] |= {"tracked": 1, "volumes": 1}
    text = following_verdict(summary).text
    assert "its tip was 0.50 mm from the true one" in text
    assert "half of" not in text


def test_a_needle_that_was_found_is_not_said_to_be_missing(summary):
    why = "No line is a needle with certainty yet."
    summary["detection"] |= {"volume": None, "reason": why}
    assert str(following_verdict(summary)).startswith(
        "The needle was found and followed. Whenever it was found, the estimate lay far from it"
    )
    summary["success"]["found"] = False
    assert str(following_verdict(summary)).startswith(f"No needle was found. {why}")


def test_recordings_without_truth_have_a_verdict_too():
    told = {"frame": "LPS", "reasons": {"it rains": 5}, "advice": "wait", "found_s": None}
    none = recording_verdict({"volumes": 5, "modes": {"searching": 5}, **told})
    assert str(none) == (
        "No needle was found. Volumes without a needle: 5 x it rains. What to change: wait."
    )
    found = {"frame": "LPS", "found_s": 2.0, "last_tip_mm": [1.0, -2.0, 3.0]}
    found |= {"volumes": 3, "modes": {"searching": 1, "tracking": 2}}
    assert str(recording_verdict(found)) == (
        "A needle was found at 2.00 s and tracked in 2 of 3 volumes; its tip was last at "
        "(1.0, -2.0, 3.0) mm in LPS."
    )
    told |= {"volumes": 3, "modes": {"searching": 3}, "interrupted": True}
    assert "It was interrupted after 3 volumes." in str(recording_verdict(told))
    assert str(recording_verdict({**told, "poses": False})).endswith(
        "The volumes have no poses: the probe counts as at rest."
    )


def test_telling_volumes_are_detection_loss_worst_and_rest(insertion_log):
    tip = insertion_log.volume_estimate_tip.copy()
    tip[20] += [2e-3, 0, 0]
    mode = insertion_log.volume_estimate_mode.copy()
    mode[25] = "lost"
    log = replace(insertion_log, volume_estimate_tip=tip, volume_estimate_mode=mode)
    found = int(np.flatnonzero(mode == "tracking")[0])
    moments = key_volumes(log)
    assert list(moments) == [found, 20, 25, len(mode) - 1]
    assert [moments[each].split(",")[0] for each in moments] == [
        "the needle is found",
        "the largest error of the tip",
        "the needle is lost",
        "the needle is at rest",
    ]
    assert "(2.30 mm along the needle, 0.40 mm across it)" in moments[20]


def test_without_a_needle_the_volume_that_shows_most_of_it_is_telling(make_log):
    time = np.arange(4.0)
    log = make_log(4, 4, time=time, volume_time=time, volume_true_time=time,
                   visible_length=np.array([0, 0, 0.03, 0.02]))  # fmt: skip
    ((volume, words),) = key_volumes(log).items()
    assert volume == 2
    assert "not found" in words
    assert len(true_needle(log, 2)) == 0
    assert plot_key_frames(log, []) == {}
    unseen = replace(log, visible_length=np.zeros(4))
    assert key_volumes(unseen) == {3: "the last volume; none shows a needle"}
