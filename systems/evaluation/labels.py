"""Labels of a run's figures, and the sections in which reports show them."""

from collections.abc import Iterable, Mapping
from typing import Any

LABELS = {
    "success.outcome": "outcome",
    "detection.volume": "insertion detected at volume",
    "detection.visible_mm": "needle in view at detection, mm",
    "detection.false_starts": "false starts in the whole run",
    "tracking.volumes": "volumes since then, with the needle in the tissue",
    "tracking.tracked": "of these, needle tracked",
    "tracking.lost_events": "times lost",
    "tracking.tip_error_mm.median": "tip error, median, mm",
    "tracking.tip_error_mm.p95": "tip error, 95 %, mm",
    "tracking.axis_error_deg.median": "axis error, median, deg",
    "tracking.axis_error_deg.p95": "axis error, 95 %, deg",
    "tracking.consistency.tip.within_95": "share of tips inside the stated 95 %",
    "tracking.wrong_s": "time with something else taken for the needle, s",
    "tracking.absent_s": "time with an estimate but no needle, s",
    "servo.at_rest.x_mm": "at rest: mean |X|, true, mm",
    "servo.at_rest.z_mm": "at rest: mean |Z|, true, mm",
    "servo.at_rest.theta_deg": "at rest: mean |Theta|, true, deg",
    "servo.at_rest_estimated.x_mm": "at rest: mean |X|, estimated, mm",
    "servo.at_rest_estimated.z_mm": "at rest: mean |Z|, estimated, mm",
    "servo.at_rest_estimated.theta_deg": "at rest: mean |Theta|, estimated, deg",
    "force.mean_n": "contact force, mean, N",
    "force.rms_error_n": "contact force, RMS error, N",
    "force.max_n": "contact force, largest, N",
    "guard.interventions": "times stopped by the guard",
    "guard.volumes_refused": "volumes refused as implausible",
    "compute_ms.render.median": "rendering a sweep, median, ms",
    "compute_ms.convert.median": "scan conversion, median, ms",
    "compute_ms.track.median": "tracking, median, ms",
    "real_time_factor": "simulated time / wall time",
}
"""Label of each figure of a summary that tables show, by its dotted path."""

MORE_LABELS = {
    "detection.inserted_mm": "needle in the tissue at detection, mm",
    "tracking.tip_error_mm.max": "tip error, largest, mm",
    "tracking.tip_axial_error_mm.median": "tip error along the needle, median, mm",
    "tracking.tip_lateral_error_mm.median": "tip error across the needle, median, mm",
    "tracking.axis_error_deg.max": "axis error, largest, deg",
    "servo.moving.x_mm": "while the needle moves: mean |X|, true, mm",
    "servo.moving.z_mm": "while the needle moves: mean |Z|, true, mm",
    "servo.moving.theta_deg": "while the needle moves: mean |Theta|, true, deg",
    "force.contact_lost_s": "time without contact after the first contact, s",
    "guard.stopped_s": "time stopped by the guard, s",
    "compute_ms.track.max": "tracking, longest, ms",
}
"""Labels of further figures, which only a report shows."""

_RECORDING = {
    "volumes": "volumes",
    "skipped": "left out: marked as invalid, or without a pose or time",
}

_SECTIONS = {
    "success": "Outcome",
    "detection": "Finding the needle",
    "tracking": "Tracking",
    "servo": "Keeping the needle centred",
    "prediction": "Predicted shape",
    "force": "Contact force",
    "guard": "Guard",
    "compute_ms": "Speed",
    "real_time_factor": "Speed",
}
"""Heading of each block of a summary."""


def look_up(summary: Mapping[str, Any], path: str) -> Any:
    """Return the entry of a nested mapping at a dotted path; None if there is none."""
    node: Any = summary
    for key in path.split("."):
        node = node.get(key) if isinstance(node, Mapping) else None
    return node


def recording_labels(modes: Iterable[str]) -> dict[str, str]:
    """Return the labels of a tracked recording's figures."""
    after = {f"modes.{mode}": f"volumes in the mode {mode}" for mode in modes}
    return _RECORDING | after


def sections(labels: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Return labels by the heading of the section to which they belong."""
    found: dict[str, dict[str, str]] = {}
    for path, label in labels.items():
        heading = _SECTIONS.get(path.partition(".")[0], "Volumes")
        found.setdefault(heading, {})[path] = label
    return found
