"""Verdict on a run in which a needle's shape is predicted, in a sentence or two."""

from collections.abc import Mapping
from typing import Any

from sonoservo.systems.evaluation.labels import look_up
from sonoservo.systems.evaluation.reports.verdict import Verdict


def shape_verdict(summary: Mapping[str, Any]) -> Verdict:
    """Return the verdict on a run of shape prediction, from its summary."""
    tracking = summary["tracking"]
    text = f"Its cross-section was found in {tracking['found']} of {tracking['slices']} slices"
    median = look_up(tracking, "error_mm.median")
    text += "." if median is None else f", {median:.2f} mm from the true one (median)."
    if summary.get("interrupted"):
        text = f"The run was interrupted. {text}"
    prediction = summary["prediction"]
    if "tip_error_true_mm" not in prediction:
        return Verdict("The needle's shape was not predicted", text, "bad")
    headline = (
        f"From the first {prediction['observed_mm']:.0f} mm, the tip was predicted to "
        f"{prediction['tip_error_true_mm']:.2f} mm"
    )
    held = 100 * prediction["covers_points"]
    text = (
        f"The estimate states a standard deviation of {prediction['tip_std_mm']:.2f} mm, and its "
        f"95 % tube holds the true needle at {held:.0f} % of the depths. {text}"
    )
    good = tracking["to_the_end"] and prediction["covers_tip"]
    return Verdict(headline, text, "good" if good else "mixed")
