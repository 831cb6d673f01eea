"""A run as a log for a viewer: what of it is written, under which name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sonoservo.systems.evaluation.run_errors import features
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.viewer_logs.mcap_log import McapLog
from sonoservo.systems.evaluation.viewer_logs.rerun_log import RerunLog
from sonoservo.systems.evaluation.viewer_logs.viewer_log import Colour, Floats, ViewerLog
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.volume import Volume

FORMATS: dict[str, Callable[[Path], ViewerLog]] = {".rrd": RerunLog, ".mcap": McapLog}
"""Class of a log, by the suffix of its file."""

_TRUE: Colour = (0, 114, 178)
_ESTIMATED: Colour = (230, 159, 0)
_QUIET: Colour = (150, 150, 150)

_PIXEL = 0.5e-3  # pixel size of the slices, in m


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a log of a run does not hold."""

    sector: Sequence[Floats] = ()  # edges of the swept sector in P, in m
    arm_points: Callable[[Floats], Floats] | None = None


def open_viewer_log(path: Path) -> ViewerLog:
    """Return a log for a viewer, whose format the file's suffix, one of `FORMATS`, chooses."""
    if path.suffix not in FORMATS:
        allowed = " or ".join(FORMATS)
        raise ConfigurationError(f"log: {path} is not allowed; its name must end in {allowed}")
    return FORMATS[path.suffix](path)


def write_volume(log: ViewerLog, volume: Volume, estimate: NeedleEstimate) -> None:
    """Write a volume, and the two slices through the needle in it that is estimated."""
    log.volume(volume.time, volume)
    for name, plane in zip(("along", "across"), slice_planes(volume, estimate.curve), strict=False):
        log.image(f"slices/{name}", volume.time, sample_plane(volume, plane, _PIXEL))


def write_run(log: ViewerLog, run: RunLog, surroundings: Surroundings) -> None:
    """Write all that a run's log holds: arm, probe, needle, estimate, force and words."""
    time = run.time
    probed = np.isfinite(run.X_WP).all(axis=(1, 2))
    if probed.any():
        log.poses("probe", time[probed], run.X_WP[probed])
        for number, edge in enumerate(surroundings.sector):
            first = np.asarray(edge, float)[np.newaxis]
            log.lines(f"probe/sector/{number}", time[probed][:1], first, _QUIET)
    joints = run.joint_state[:, : run.joint_state.shape[1] // 2]
    moving = np.isfinite(joints).all(axis=1)
    if surroundings.arm_points is not None and moving.any():
        log.lines("arm", time[moving], surroundings.arm_points(joints[moving]), _QUIET)
    for number, position in enumerate(joints.T):
        log.scalars(f"joints/{number + 1}", time, position)
    log.lines("needle/true", time, run.needle_points, _TRUE)
    estimated = np.stack([run.estimate_entry, run.estimate_tip], axis=1)
    log.lines("needle/estimated", time, estimated, _ESTIMATED)
    log.ellipsoids(
        "needle/doubt", run.volume_seen, run.volume_estimate_tip, run.volume_estimate_tip_covariance
    )
    log.scalars("force/contact", time, run.contact_force)
    log.scalars("force/wrist", time, np.linalg.norm(run.wrist_force[:, 3:], axis=1))
    true = features(run.X_WP, run.needle_tip, run.needle_entry)
    seen = features(run.measured_X_WP, run.estimate_tip, run.estimate_entry)
    for kind, values in (("true", true), ("estimated", seen)):
        for name, column in zip(("x", "z", "theta"), values.T, strict=True):
            log.scalars(f"features/{kind}/{name}", time, column)
    for name, column in zip(("v_x", "v_z", "omega_y"), run.planar_velocity.T, strict=True):
        log.scalars(f"command/{name}", time, column)
    log.texts("mode", time, run.estimate_mode.tolist())
    log.texts("reason/guard", time, run.guard_reason.tolist())
    log.texts("reason/hold", time, run.hold_reason.tolist())
    log.texts("reason/measurement", run.volume_seen, run.volume_measurement_reason.tolist())
