import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic_logs import build_log

from sonoservo.systems.evaluation import summarize
from sonoservo.systems.evaluation.metrics import missing_needle
from sonoservo.systems.signals.search_reason import Reader, ReasonCount, advice


def test_the_whole_summary_is_json(insertion_log, make_log):
    for log in (insertion_log, make_log(0, 0), make_log(5, 3), make_log(1, 0, time=np.zeros(1))):
        json.dumps(summarize(log), allow_nan=False)
    assert summarize(insertion_log)["compute_ms"] == {"track": {"median": 5.0, "max": 9.0}}
    nothing = summarize(make_log(4, 2, time=np.arange(4.0)))
    assert nothing["detection"].pop("false_starts") == nothing["tracking"]["volumes"] == 0
    assert set(nothing["detection"].values()) == {None}
    assert set(nothing["tracking"]["tip_error_mm"].values()) == {None}
    assert nothing["servo"]["at_rest"]["x_mm"] is nothing["force"]["mean_n"] is None


def test_detection(insertion_log):
    summary = summarize(insertion_log)
    first = int(np.argmax(insertion_log.volume_time >= 4))
    expected = 5 * (insertion_log.volume_time[first] - 2)
    assert summary["detection"]["volume"] == first
    assert summary["detection"]["inserted_mm"] == pytest.approx(expected)
    assert summary["detection"]["false_starts"] == 0
    assert summary["detection"]["reason"] is None


@pytest.mark.parametrize("volume", [2, 9])  # before the needle is there, and while it is
def test_a_start_away_from_the_needle_is_false(insertion_log, volume):
    tip, entry = (
        insertion_log.volume_estimate_tip.copy(),
        insertion_log.volume_estimate_entry.copy(),
    )
    tip[volume], entry[volume] = [0.0, 0.02, -0.04], [0.0, 0.04, -0.04]
    log = replace(insertion_log, volume_estimate_tip=tip, volume_estimate_entry=entry)
    detection = summarize(log)["detection"]
    assert detection["false_starts"] == 1
    assert detection["volume"] == summarize(insertion_log)["detection"]["volume"]
    assert summarize(log)["tracking"] == summarize(insertion_log)["tracking"]


def test_a_ghost_that_is_found_again_is_a_false_start(insertion_log):
    mode = insertion_log.volume_estimate_mode.copy()
    mode[30:34] = "lost"
    lost = replace(insertion_log, volume_estimate_mode=mode)
    assert summarize(lost)["detection"]["false_starts"] == 0
    tip = insertion_log.volume_estimate_tip + np.where(np.arange(len(mode)) >= 34, 0.02, 0)[:, None]
    ghost = replace(lost, volume_estimate_tip=tip)
    assert summarize(ghost)["detection"]["false_starts"] == 1


def test_an_estimate_that_stays_when_the_needle_has_gone_is_counted(insertion_log):
    time = insertion_log.time
    gone = time >= 15
    log = replace(
        insertion_log,
        inserted_length=np.where(gone, 0.0, insertion_log.inserted_length),
        planar_velocity=np.tile([3e-3, 4e-3, 0.1], (len(time), 1)),
    )
    tracking = summarize(log)["tracking"]
    assert tracking["absent_s"] == pytest.approx(time[-1] - 15, abs=1 / 32)
    without_needle = time[-1] - 15 + 2.0
    assert tracking["absent_travel_mm"] == pytest.approx(5 * without_needle, abs=0.5)
    assert summarize(insertion_log)["tracking"]["absent_s"] == 0


def test_a_needle_that_is_withdrawn_is_not_lost(insertion_log):
    """From 15 s on it comes out at 30 mm/s, and the tracker searches."""
    time, volume_time = insertion_log.time, insertion_log.volume_time
    out = np.clip(0.05 - 0.03 * (time - 15), 0, None)
    length = np.where(time >= 15, out, insertion_log.inserted_length)
    mode = np.where(volume_time > 15.2, "searching", insertion_log.volume_estimate_mode)
    lost = replace(insertion_log, volume_estimate_mode=mode)
    gone = replace(lost, inserted_length=length)
    assert summarize(gone)["tracking"]["lost"] > 0
    assert summarize(gone)["tracking"]["lost_events"] == 0
    assert summarize(lost)["tracking"]["lost_events"] == 1


def test_what_is_taken_for_the_needle_is_timed_and_a_success_has_one_definition(insertion_log):
    def outcome(**changes):
        return summarize(replace(insertion_log, **changes))["success"]["outcome"]

    success = summarize(insertion_log)["success"]
    assert success["outcome"] == "found and kept"
    assert success["right"] == success["judged"] > 40
    away = np.where(insertion_log.time[:, np.newaxis] > 18, [0.0, 0.02, 0.0], 0.0)
    wrong = replace(insertion_log, estimate_tip=insertion_log.estimate_tip + away)
    assert summarize(wrong)["tracking"]["wrong_s"] == pytest.approx(2, abs=0.1)
    aside = np.array([0, 3e-3, 0])
    tip, entry = (
        each + aside
        for each in (insertion_log.volume_estimate_tip, insertion_log.volume_estimate_entry)
    )
    inaccurate = outcome(volume_estimate_tip=tip, volume_estimate_entry=entry)
    assert inaccurate == "kept, but inaccurate"
    mode = insertion_log.volume_estimate_mode.copy()
    mode[-10:] = "lost"
    assert outcome(volume_estimate_mode=mode) == "found, not kept"


def test_tracking_errors(insertion_log):
    tracking = summarize(insertion_log)["tracking"]
    found = int(np.sum(np.isfinite(insertion_log.volume_estimate_tip[:, 0])))
    assert tracking["volumes"] == tracking["tracked"] == tracking["estimated"] == found
    assert tracking["lost"] == tracking["lost_events"] == 0
    for statistic in ("median", "p95", "max"):
        assert tracking["tip_error_mm"][statistic] == pytest.approx(0.5)
        assert tracking["tip_axial_error_mm"][statistic] == pytest.approx(0.3)
        assert tracking["tip_lateral_error_mm"][statistic] == pytest.approx(0.4)
        assert tracking["axis_error_deg"][statistic] == pytest.approx(0, abs=1e-6)
    assert tracking["tip_axial_bias_mm"] == pytest.approx(0.3)


def test_failures_stay_in_the_statistics(insertion_log):
    first = summarize(insertion_log)["detection"]["volume"]
    mode = insertion_log.volume_estimate_mode.copy()
    tip = insertion_log.volume_estimate_tip.copy()
    entry = insertion_log.volume_estimate_entry.copy()
    mode[first + 1] = "coasting"  # with less than 15 mm inside: not lost
    mode[first + 10 : first + 13] = "coasting", "lost", "lost"
    tip[first + 11] += [0, 0.1, 0]  # a wrong estimate counts
    mode[first + 20] = "searching"  # none at all counts as lost
    tip[first + 20] = entry[first + 20] = np.nan
    log = replace(
        insertion_log,
        volume_estimate_mode=mode,
        volume_estimate_tip=tip,
        volume_estimate_entry=entry,
    )
    tracking, before = summarize(log)["tracking"], summarize(insertion_log)["tracking"]
    assert tracking["volumes"] == before["volumes"]
    assert tracking["tracked"] == before["tracked"] - 5
    assert tracking["estimated"] == before["estimated"] - 1
    assert tracking["lost"] == 4
    assert tracking["lost_events"] == 2
    assert tracking["tip_error_mm"]["max"] == pytest.approx(np.hypot(100, 0.5))


def test_servo(insertion_log):
    servo = summarize(insertion_log)["servo"]
    # The needle stops at 12 s at X = 0, 50 mm from its entry; 3 s of transient are left out.
    assert servo["at_rest"]["x_mm"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["z_mm"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["theta_deg"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["seconds"] == pytest.approx(20 - 12 - 3, abs=0.5)
    assert servo["at_rest_estimated"]["x_mm"] == pytest.approx(0.3)
    # While it moves and is tracked, x runs from where it is found to 0; that it has stopped shows
    # up to half a window later.
    tracked = insertion_log.estimate_mode == "tracking"
    most, least = (
        1e3 * np.mean(50e-3 - insertion_log.inserted_length[tracked & (insertion_log.time < end)])
        for end in (12.0, 12.5)
    )
    assert least < servo["moving"]["x_mm"] < most
    tip = insertion_log.needle_tip + 5e-3 * np.sin(insertion_log.time)[:, np.newaxis]
    moving = summarize(replace(insertion_log, needle_tip=tip))["servo"]  # the phantom moves
    assert moving["at_rest"]["x_mm"] is None


@pytest.mark.parametrize(("speed", "touched"), [(0.0, False), (0.01, None)])
def test_a_run_without_contact_is_told_unless_the_probe_is_on_its_way(make_log, speed, touched):
    time = np.arange(0, 2, 0.01)
    X_WP = np.tile(np.eye(4), (len(time), 1, 1))
    X_WP[:, 1, 3] = speed * time
    log = make_log(len(time), 0, time=time, X_WP=X_WP, contact_force=np.zeros(len(time)))
    summary = summarize(log)
    assert summary["force"]["touched"] is touched
    assert ("max_speed" in (summary["detection"]["advice"] or "")) == (touched is False)


def test_force(insertion_log):
    force = summarize(insertion_log)["force"]
    assert force["contact_lost_s"] == pytest.approx(0.5)
    assert force["max_n"] == 2.0
    settled = 20 - 3  # from 2 s after the first contact at 1 s
    assert force["mean_n"] == pytest.approx(2 * (1 - 0.5 / settled))
    assert force["rms_error_n"] == pytest.approx(2 * np.sqrt(0.5 / settled))


def test_stops_and_refusals(insertion_log):
    guard = summarize(insertion_log)["guard"]
    assert guard == {
        "interventions": 0, "stopped_s": 0.0, "reasons": None, "stopped_at_end": None,
        "volumes_refused": 0, "refusal": None,
    }  # fmt: skip
    time = insertion_log.time
    reason = np.where((time > 3) & (time < 4), "too much force", "")
    reason = np.where((time > 6) & (time < 6.5), "frozen", reason)
    reason = np.where(time > 19, "frozen", reason)
    refused = np.where(time > 5, 2.0, 0.0)
    refusal = np.where((time > 5) & (time < 6), "it is blank", "")
    log = replace(
        insertion_log, guard_reason=reason, volumes_refused=refused, refusal_reason=refusal
    )
    guard = summarize(log)["guard"]
    assert guard.pop("stopped_s") == pytest.approx(2.5, abs=0.2)
    assert guard == {
        "interventions": 3, "reasons": "too much force; frozen", "stopped_at_end": "frozen",
        "volumes_refused": 2, "refusal": "it is blank",
    }  # fmt: skip


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


def told(run, reader=Reader.SCENARIO):
    reason, remedies = missing_needle(run)
    return reason, advice(remedies, reader)


def test_the_most_frequent_reason_while_the_needle_is_in_view_counts():
    reason, change = told(log([NONE, MOVED, MOVED, STILL, NONE, STILL, STILL]))
    assert reason == "Nothing changed by more than 2.1 dB."
    assert change.startswith("push the needle in while the probe looks on (hand.pushes, hand.aim)")
    for reader, name in ((Reader.OPERATOR, ""), (Reader.RECORDING, " (--start anywhere)")):
        _, change = told(log([NONE, STILL, STILL]), reader)
        assert change.endswith(f"or look for it in whole volumes{name}")
        assert "hand." not in change
    reason, change = told(log([NONE, NONE, "the change is spread over 9 mm", NONE, MOVED, STILL]))
    assert reason == "The change is spread over 31 mm."
    assert "more slowly" in change
    line = "no line stands out as a needle does"  # of a search in the whole volume
    reason, change = told(log(["a needle is being tracked"] * 4, measured=[line] * 4))
    assert reason == "No line stands out as a needle does."
    assert "hand.dip_deg" in change


def test_a_detection_that_is_not_confirmed_is_said_to_be_so():
    """The needle comes to rest before enough volumes show its motion."""
    fast = log([""] * 4, measured=["no needle has been detected"] * 4)
    reason, change = told(replace(fast, volume_detected=np.ones(4, bool)))
    assert reason == "Something moved; the needle is not confirmed yet."
    assert "more slowly" in change


@pytest.mark.parametrize(
    ("truth", "beginning", "field", "recorded"),
    [
        ({"visible": 0.0}, "The needle never came into view. Nothing changed", "hand.aim", "push"),
        ({"inserted": 0.0}, "The needle stayed outside the tissue.", "hand.start", "record"),
    ],
)
def test_a_needle_that_could_not_be_seen_is_said_to_be_so(truth, beginning, field, recorded):
    run = log([NONE, STILL, STILL], **truth)
    reason, change = told(run)
    assert reason.startswith(beginning)
    assert field in change
    assert told(run, Reader.RECORDING)[1].startswith(recorded)


def test_a_needle_out_of_view_of_a_robot_that_was_stopped_is_not_blamed_alone():
    run = log([NONE, STILL, STILL, STILL], visible=0.0)
    reasons = np.where((run.time >= 1) & (run.time < 2.5), "the force was too large", "")
    reason, _ = told(replace(run, guard_reason=reasons))
    assert "came into view. The guard had stopped the robot for 1.5 s. Nothing" in reason


def test_a_run_too_short_for_a_volume_says_so():
    assert told(build_log(0, 0)) == (
        "No volume was acquired.",
        "let the run be longer (duration)",
    )


def test_reasons_are_counted_by_kind_the_most_frequent_first():
    count = ReasonCount(
        [MOVED, STILL, "it rains", "", STILL, "the change is spread over 9 mm", STILL]
    )
    assert count.words == {"nothing changes": 3, "too much changes at once": 2, "it rains": 1}
    assert "--start anywhere" in count.advice(Reader.RECORDING)
    assert "--start anywhere" not in count.advice(Reader.RECORDING_ANYWHERE)
    assert ReasonCount(["it rains"]).advice(Reader.RECORDING) == ""
