"""Verdict on a run in which the robot follows a needle, in a sentence or two."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from sonoservo.systems.evaluation.labels import look_up


@dataclass(frozen=True)
class Verdict:
    """Outcome of a run in words.

    Parameters
    ----------
    headline
        The outcome, without a full stop.
    text
        Sentences with the figures that support it; may be empty.
    grade
        Whether the run reached its aim: "good", "mixed" or "bad".
    """

    headline: str
    text: str = ""
    grade: Literal["good", "mixed", "bad"] = "good"

    def __str__(self) -> str:
        return f"{self.headline}. {self.text}".strip()


def following_verdict(summary: Mapping[str, Any], *, follows: bool = True) -> Verdict:
    """Return the verdict on a run of following, from its summary.

    Parameters
    ----------
    summary
        Summary of the run; see `summarize`.
    follows
        Whether the visual servo moves the probe; otherwise nothing is said about centring.
    """
    found = look_up(summary, "detection.volume") is not None
    stopped = look_up(summary, "guard.stopped_at_end")
    lost = look_up(summary, "tracking.lost_events") or 0
    wrong = look_up(summary, "detection.false_starts") or 0
    text = " ".join(filter(None, (_missing(summary), _found(summary), _rest(summary, follows))))
    if summary.get("interrupted"):
        text = f"The run was interrupted after {summary['simulated_s']:.1f} s. {text}"
    if stopped:
        text = text if found else f"No needle was found. {text}"
        return Verdict(f"The guard stopped the robot because {stopped}", text, "bad")
    if look_up(summary, "force.touched") is False:
        return Verdict("The probe never touched the body", text, "bad")
    if not found:
        return Verdict("No needle was found", text, "bad")
    acts = "found and followed" if follows else "found and tracked"
    if wrong:
        starts = "1 false start" if wrong == 1 else f"{wrong} false starts"
        return Verdict(f"The needle was {acts}, with {starts}", text, "mixed")
    if lost:
        return Verdict(f"The needle was {acts}, and lost {_times(lost)} on the way", text, "mixed")
    return Verdict(f"The needle was {acts}", text)


def recording_verdict(summary: Mapping[str, Any]) -> Verdict:
    """Return the verdict on a tracked recording, from its summary."""
    volumes, tracked = summary["volumes"], summary["modes"].get("tracking", 0)
    if not tracked:
        return Verdict("No needle was found", _missing(summary), "bad")
    text = _found(summary)
    return Verdict(f"A needle was tracked in {tracked} of {volumes} volumes", text)


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
    return (
        f"{text}; half of the estimated tips were less than {median:.2f} mm from the true one, "
        f"95 % less than {p95:.2f} mm."
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
