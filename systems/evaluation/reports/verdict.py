"""Verdict on a run in which the robot follows a needle, in a sentence or two."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from sonoservo.systems.evaluation.labels import look_up
from sonoservo.systems.evaluation.success import RunOutcome, run_outcome
from sonoservo.systems.files.counting import counted


@dataclass(frozen=True)
class Verdict:
    """Outcome of a run in words."""

    headline: str  # without a full stop
    text: str = ""  # sentences with the figures that support it
    grade: Literal["good", "mixed", "bad"] = "good"

    def __str__(self) -> str:
        return f"{self.headline}. {self.text}".strip()


_ACTS = {
    RunOutcome.NOT_KEPT: "found, not kept",
    RunOutcome.INACCURATE: "found and kept, but not accurately",
}

_REASONS = 3  # number of reasons of lost volumes that are shown
_SHOWN = 0.5  # time in s above which the verdict says that something else was followed


def following_verdict(summary: Mapping[str, Any], *, follows: bool = True) -> Verdict:
    """Return the verdict on a run of following, from its summary."""
    outcome = run_outcome(summary)
    found = look_up(summary, "success.found")
    if found:
        why = _found(summary) or "Whenever it was found, the estimate lay far from it at first."
    else:
        why = _missing(summary)
    text = " ".join(filter(None, (why, _rest(summary, follows))))
    if summary.get("interrupted"):
        text = f"The run was interrupted after {summary['simulated_s']:.1f} s. {text}"
    wrong = look_up(summary, "tracking.wrong_s") or 0.0
    mistaken = f"something else was taken for it for {wrong:.1f} s" if wrong >= _SHOWN else ""
    if outcome is RunOutcome.STOPPED:
        stopped = look_up(summary, "guard.stopped_at_end")
        text = text if found else f"No needle was found. {text}"
        return Verdict(f"The guard stopped the robot because {stopped}", text, "bad")
    if outcome is RunOutcome.UNTOUCHED:
        return Verdict("The probe never touched the body", text, "bad")
    if outcome is RunOutcome.NOT_FOUND:
        headline = ", and ".join(filter(None, ("No needle was found", mistaken)))
        return Verdict(headline, text, "bad")
    lost = look_up(summary, "tracking.lost_events") or 0
    acts = _ACTS.get(outcome, "found and followed" if follows else "found and tracked")
    more = [f"lost {_times(lost)} on the way"] if lost else []
    headline = ", and ".join([f"The needle was {acts}", *more, *filter(None, [mistaken])])
    if outcome is RunOutcome.NOT_KEPT:
        return Verdict(headline, text, "bad")
    good = outcome is RunOutcome.SUCCESS and not more and not mistaken
    return Verdict(headline, text, "good" if good else "mixed")


def recording_verdict(summary: Mapping[str, Any]) -> Verdict:
    """Return the verdict on a tracked recording, from its summary.

    With the truth beside the recording, it is that on a run in which nothing followed the tracker.
    """
    if summary.get("truth"):
        verdict = following_verdict({**summary, "interrupted": False}, follows=False)
    elif summary["modes"].get("tracking", 0):
        verdict = Verdict(found_words(summary), _found(summary))
    else:
        verdict = Verdict(found_words(summary), " ".join(reasons_lines(summary)), "bad")
    text = " ".join([verdict.text, *pose_lines(summary)])
    if summary.get("interrupted"):
        text = f"It was interrupted after {counted(summary['volumes'], 'volume')}. {text}"
    return replace(verdict, text=text)


def pose_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return what is to be known about the poses of a recording; empty if it has them."""
    if summary.get("poses", True):
        return []
    return ["The volumes have no poses: the probe counts as at rest."]


def found_words(summary: Mapping[str, Any]) -> str:
    """Return when a needle was found, how often it was tracked, and where its tip was."""
    if (first := summary["found_s"]) is None:
        return "No needle was found"
    tip = ", ".join(f"{each:.1f}" for each in summary["last_tip_mm"])
    return (
        f"A needle was found at {first:.2f} s and tracked in {summary['modes']['tracking']} of "
        f"{counted(summary['volumes'], 'volume')}; its tip was last at ({tip}) mm in "
        f"{summary['frame']}"
    )


def reasons_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return why volumes gave no needle, and what to change; empty if all gave one."""
    lines = []
    if reasons := summary.get("reasons"):
        lines.append(f"Volumes without a needle: {reasons_text(reasons)}.")
    if advice := summary.get("advice"):
        lines.append(f"What to change: {advice}.".replace("?.", "?"))
    return lines


def reasons_text(reasons: Mapping[str, int]) -> str:
    """Return the most frequent reasons with the numbers of their volumes, on one line."""
    shown = [f"{count} x {reason}" for reason, count in list(reasons.items())[:_REASONS]]
    rest = sum(reasons.values()) - sum(list(reasons.values())[:_REASONS])
    return "; ".join(shown) + (f"; {rest} x others" if rest else "")


def unbroken(text: str) -> str:
    """Return a text with no-break spaces between numbers and their units."""
    return re.sub(r"(?<=\d) (?=%|(mm|deg|N|s)\b)", "\u00a0", text)


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def _missing(summary: Mapping[str, Any]) -> str:
    said = (look_up(summary, f"detection.{name}") for name in ("reason", "advice"))
    return " ".join(filter(None, said))


def _found(summary: Mapping[str, Any]) -> str:
    if look_up(summary, "detection.volume") is None:
        return ""
    visible = look_up(summary, "detection.visible_mm")
    when = "" if visible is None else f" with {visible:.0f} mm of it in view"
    tracking = summary.get("tracking", {})
    text = (
        f"It was found{when} and tracked in {tracking['tracked']} of the {tracking['volumes']} "
        "volumes since then"
    )
    median, p95 = (look_up(tracking, f"tip_error_mm.{each}") for each in ("median", "p95"))
    if median is None:
        return f"{text}."
    axis = look_up(tracking, "axis_error_deg.median")
    turned = "" if axis is None else f"; the needle's axis was {axis:.1f} deg off (median)"
    if tracking["tracked"] == 1:
        return f"{text}; its tip was {median:.2f} mm from the true one{turned}."
    inside = look_up(tracking, "consistency.tip.within_95")
    stated = "" if inside is None else f", and {100 * inside:.0f} % inside the stated 95 %"
    return (
        f"{text}; half of the estimated tips were less than {median:.2f} mm from the true one, "
        f"95 % less than {p95:.2f} mm{stated}{turned}."
    )


def _rest(summary: Mapping[str, Any], follows: bool) -> str:
    rest, force = (look_up(summary, each) for each in ("servo.at_rest", "force.mean_n"))
    parts = []
    if follows and rest and rest["x_mm"] is not None:
        parts.append(
            f"once at rest, the true tip was on average {rest['x_mm']:.2f} mm beside the probe's "
            f"middle (X) and {rest['z_mm']:.2f} mm out of its central image (Z), and the needle "
            f"{rest['theta_deg']:.2f} deg out of that image (Theta)"
        )
    if force is not None:
        parts.append(f"the probe pressed with {force:.2f} N")
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""
