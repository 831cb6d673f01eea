"""Errors of the poses of recorded volumes, estimated from tissue that stands still."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sonoservo.diagrams.app.volumes.opening import ReconstructedRecording
from sonoservo.systems.calibration.pose_errors import PoseCalibration, PoseErrors
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.signals.immutable import NotFound


def calibrate_recording(
    recording: Recording | ReconstructedRecording, after_volume: Callable[[int], None] | None = None
) -> PoseErrors | NotFound:
    """Estimate delay and hand-eye error of a recording's poses, from tissue that stands still."""
    if not recording.posed:
        raise ConfigurationError(f"{recording.path}: the volumes have no poses to be calibrated")
    calibration = PoseCalibration()
    for number in range(len(recording)):
        calibration = calibration.seen(recording[number])
        if after_volume is not None:
            after_volume(number)
    return calibration.errors


def pose_error_figures(errors: PoseErrors | NotFound) -> dict[str, Any]:
    """Return the errors of poses, and their standard deviations, in ms, mm and deg."""
    if isinstance(errors, NotFound):
        return {"found": False, "reason": errors.reason}
    std = errors.std
    return {
        "found": True,
        "delay_ms": 1e3 * errors.delay,
        "delay_std_ms": 1e3 * float(std[0]),
        "translation_mm": (1e3 * errors.translation).tolist(),
        "translation_std_mm": (1e3 * std[1:4]).tolist(),
        "rotation_deg": np.rad2deg(errors.rotation).tolist(),
        "rotation_std_deg": np.rad2deg(std[4:]).tolist(),
        "pairs": errors.pairs,
        "blocks": errors.blocks,
    }
