"""Errors of the poses of recorded volumes, estimated from tissue that stands still."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sonoservo.diagrams.app.volumes.opening import ReconstructedRecording
from sonoservo.systems.calibration.pose_errors import PoseCalibration, PoseErrors, told_errors
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.signals.immutable import NotFound

_UNITS = np.array([*4 * [1e3], *3 * [np.rad2deg(1.0)]])  # ms, mm and deg in s, m and rad


def calibrate_recording(
    recording: Recording | ReconstructedRecording, after_volume: Callable[[int], None] | None = None
) -> PoseErrors | NotFound:
    """Estimate delay and hand-eye error of a recording's poses, from tissue that stands still."""
    if isinstance(recording, ReconstructedRecording):
        raise ConfigurationError(
            f"{recording.path}: volumes made of frames have no pose of their own to be calibrated; "
            "`sonoservo check` tells the delay"
        )
    if not recording.posed:
        raise ConfigurationError(f"{recording.path}: the volumes have no poses to be calibrated")
    calibration = PoseCalibration()
    for number in range(len(recording)):
        calibration = calibration.seen(recording[number])
        if after_volume is not None:
            after_volume(number)
    return calibration.errors


def pose_error_figures(errors: PoseErrors | NotFound) -> dict[str, Any]:
    """Return the errors of poses, and their standard deviations, in ms, mm and deg.

    Both are None where the volumes do not tell them.
    """
    errors = told_errors(errors)
    if isinstance(errors, NotFound):
        return {"found": False, "reason": errors.reason}
    found = np.array([errors.delay, *errors.translation, *errors.rotation])
    (delay, *rest), (delay_std, *rest_std) = (
        [value if told else None for value, told in zip(each, errors.told, strict=True)]
        for each in (_UNITS * found, _UNITS * errors.std)
    )
    return {
        "found": True,
        "delay_ms": delay,
        "delay_std_ms": delay_std,
        "translation_mm": rest[:3],
        "translation_std_mm": rest_std[:3],
        "rotation_deg": rest[3:],
        "rotation_std_deg": rest_std[3:],
        "pairs": errors.pairs,
        "blocks": errors.blocks,
    }
