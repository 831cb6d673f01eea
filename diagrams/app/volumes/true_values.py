"""Values of a recording's ground truth, for the console."""

import numpy as np

from sonoservo.systems.recording.side_files import Truth
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume


def true_values(truth: Truth | None, volume: Volume, estimate: NeedleEstimate) -> dict[str, float]:
    """Return the error of the tip in mm and the contact force in N, if there is a truth."""
    if truth is None:
        return {}
    sample = truth.at(volume.time)
    needle, error = truth.needles[sample], np.nan
    if needle and estimate.curve is not None:
        error = 1e3 * float(np.linalg.norm(estimate.curve.tip - needle.tip))
    return {"error": error, "force": float(truth.contact_force[sample])}
