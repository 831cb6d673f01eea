"""Leaf system that logs a run in which the robot follows a needle."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.evaluation.log import LogRows, Row, columns
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.ports import declare_inputs, evaluate_optional_port
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.sweep import MotionRecord, SweepGeometry
from sonoservo.systems.signals.volume import VolumeCheck

T = TypeVar("T")


def _new_rows(extents: Mapping[str, int]) -> dict[str, LogRows]:
    """Return the rows of samples, named n, and of volumes, named v, by their first extent."""
    return {
        first: LogRows(
            {name: each for name, each in columns(RunLog).items() if each.shape[0] == first},
            extents,
        )
        for first in "nv"
    }


class RunLogger(LeafSystem):
    """Logs samples of truth and estimates, and a row for every volume that the tracker processed.

    .. pydrake_system::

        name: RunLogger
        input_ports:
        - X_WP
        - X_WT
        - true_X_WP (optional)
        - motion_record (optional)
        - needle (optional)
        - estimate (optional)
        - measurement (optional)
        - detection (optional)
        - joint_state (optional)
        - wrist_force (optional)
        - contact_force (optional)
        - planar_velocity (optional)
        - guard (optional)
        - hold_reason (optional)
        - volume_check (optional)

    Every port may stay unconnected; its values are then missing. Without `true_X_WP`, `X_WP` is
    logged as the true pose too. `motion_record`, `measurement` and `detection` are those from which
    the estimate was made; a row is added whenever the estimate names a newer volume, and no volume
    is computed for it. `needle` is in T, `joint_state` in rad and rad/s, `planar_velocity` v_x, v_z
    and omega_y of P.

    The log is kept in the context and cleared whenever a simulator is initialised; it grows by 2 MB
    a simulated minute.

    Parameters
    ----------
    period
        Time between samples, in s.
    volume_period, volume_offset
        Period of additional checks for a new volume, and time of the first one, in s: shortly after
        the tracker's events.
    joints
        Number of joints of the arm.
    geometry
        Geometry of the sweeps, which bounds the part of the needle in view.
    """

    def __init__(
        self,
        *,
        period: float = 1 / 32,
        volume_period: float | None = None,
        volume_offset: float = 0.0,
        joints: int = 6,
        geometry: SweepGeometry | None = None,
    ) -> None:
        super().__init__()
        self._inputs = declare_inputs(
            self,
            X_WP=RigidTransform,
            X_WT=RigidTransform,
            true_X_WP=RigidTransform,
            motion_record=(MotionRecord, NotFound),
            needle=Needle,
            estimate=NeedleEstimate,
            measurement=(NeedleMeasurement, NotFound),
            detection=object,
            guard=GuardStatus,
            hold_reason=str,
            volume_check=VolumeCheck,
            joint_state=2 * joints,
            wrist_force=SpatialForce,
            contact_force=1,
            planar_velocity=3,
        )
        self._geometry = geometry
        self._rows = declare_memory(self, lambda: _new_rows({"2j": 2 * joints}))
        declare_looks(self, self._sample, period=period, start=self._start)
        if volume_period is not None:
            require_positive(volume_period=volume_period)
            self.DeclarePeriodicPublishEvent(volume_period, volume_offset, self._look)

    def log(self, context: Context, compute: Mapping[str, ArrayLike] | None = None) -> RunLog:
        """Return the log so far; it is complete up to that time even if the run was cut short."""
        times = {name: np.asarray(each, float) for name, each in (compute or {}).items()}
        samples, volumes = (rows.arrays() for rows in self._rows(context).values())
        return RunLog(**samples, **volumes, compute=times)

    def _input(
        self, context: Context, name: str, expected: type[T] | tuple[type[T], ...]
    ) -> T | None:
        """Return the value of an input; None if it has none."""
        return evaluate_optional_port(self._inputs[name], context, expected)

    def _start(self, context: Context) -> None:
        for rows in self._rows(context).values():
            rows.clear()

    def _sample(self, context: Context) -> None:
        time, samples = context.get_time(), self._rows(context)["n"]
        if samples.newest and samples.newest["time"] >= time:
            return
        X_WP, true, X_WT = (
            self._input(context, name, RigidTransform) for name in ("X_WP", "true_X_WP", "X_WT")
        )
        row: Row = {"time": time}
        for name, X in (("X_WP", true or X_WP), ("measured_X_WP", X_WP), ("X_WT", X_WT)):
            if X is not None:
                row[name] = X.GetAsMatrix4()
        if (needle := self._input(context, "needle", Needle)) is not None:
            row |= self._truth(needle, true or X_WP, X_WT)
        estimate = self._input(context, "estimate", NeedleEstimate)
        if estimate is not None:
            row |= _describe(estimate, "estimate")
            if estimate:
                row["estimate_velocity"] = estimate.tip_velocity
            self._look(context)
        wrist_force = self._input(context, "wrist_force", SpatialForce)
        if wrist_force is not None:
            row["wrist_force"] = wrist_force.get_coeffs()
        for name in ("contact_force", "joint_state", "planar_velocity"):
            vector = self._input(context, name, np.ndarray)
            if vector is not None:
                row[name] = vector[0] if name == "contact_force" else vector.copy()
        if (guard := self._input(context, "guard", GuardStatus)) is not None:
            row["guard_state"] = str(guard.state)
            row["guard_reason"] = guard.reason if guard.stopped else ""
        row["hold_reason"] = self._input(context, "hold_reason", str) or ""
        if (check := self._input(context, "volume_check", VolumeCheck)) is not None:
            row["volumes_refused"], row["refusal_reason"] = check.refused, check.reason
        samples.append(row)

    def _truth(
        self, needle: Needle, X_WP: RigidTransform | None, X_WT: RigidTransform | None
    ) -> Row:
        length = needle.length
        row: Row = {"inserted_length": length}
        if needle and X_WT is not None:
            row["needle_tip"] = X_WT.multiply(needle.tip)
            row["needle_entry"] = X_WT.multiply(needle.shaft[0])
            points = needle.position(np.linspace(0, length, 9))
            row["needle_points"] = X_WT.multiply(points.T).T
        if self._geometry is not None and X_WP is not None and X_WT is not None:
            in_probe = needle.transformed(X_WP.InvertAndCompose(X_WT))
            row["visible_length"] = visible_length(in_probe, self._geometry)
        return row

    def _look(self, context: Context) -> None:
        """Add a row if the estimate was made from a volume newer than the last one logged."""
        estimate = self._input(context, "estimate", NeedleEstimate)
        volumes = self._rows(context)["v"]
        if estimate is None or not np.isfinite(estimate.volume_time):
            return
        if volumes.newest and volumes.newest["volume_time"] >= estimate.volume_time:
            return
        row: Row = {"volume_time": estimate.volume_time, "volume_seen": context.get_time()}
        row |= self._motions(context, estimate.volume_time)
        row |= _describe(estimate, "volume_estimate")
        if estimate.curve is not None:
            row["volume_estimate_points"] = estimate.curve.position([0, 0.5, 1])
            row["volume_estimate_velocity"] = estimate.tip_velocity
            row["volume_estimate_tip_covariance"] = estimate.tip_covariance
            row["volume_estimate_direction_covariance"] = estimate.direction_covariance
            row["volume_estimate_velocity_covariance"] = estimate.tip_velocity_covariance
        detection = self._input(context, "detection", object)
        row["volume_detected"] = bool(detection)
        row["volume_detection_reason"] = _reason(detection)
        measurement = self._input(context, "measurement", (NeedleMeasurement, NotFound))
        row["volume_measurement_reason"] = _reason(measurement)
        if isinstance(measurement, NeedleMeasurement):
            row["volume_measured_time"] = measurement.time
            row["volume_measured_tip"] = measurement.curve.tip
            row["volume_measured_entry"] = measurement.curve.entry
            row["volume_inlier_count"] = measurement.inlier_count
            row["volume_inlier_ratio"] = measurement.inlier_ratio
        volumes.append(row)

    def _motions(self, context: Context, volume_time: float) -> Row:
        """Return the measured and the true motion of a volume, if it is the newest."""
        record = self._input(context, "motion_record", (MotionRecord, NotFound))
        if not isinstance(record, MotionRecord):
            return {}
        middle = record.true.geometry.frames // 2
        if record.measured.times[middle] != volume_time:
            return {}
        return {
            "volume_X_WP": record.measured.X_WP[middle],
            "volume_true_time": record.true.times[middle],
            "volume_true_X_WP": record.true.X_WP[middle],
        }


def visible_length(needle: Needle, geometry: SweepGeometry) -> float:
    """Return the length of a needle in P that lies in the swept sector, in m, to 0.5 mm."""
    if not needle:
        return 0.0
    points = needle.position(np.arange(0.25e-3, needle.length, 0.5e-3))
    return 0.5e-3 * float(geometry.contains(points).sum())


def _describe(estimate: NeedleEstimate, prefix: str) -> Row:
    row: Row = {f"{prefix}_mode": str(estimate.mode), f"{prefix}_time": estimate.time}
    if estimate.curve is not None:
        row[f"{prefix}_tip"] = estimate.curve.tip
        row[f"{prefix}_entry"] = estimate.curve.entry
    return row


def _reason(value: object) -> str:
    return value.reason if isinstance(value, NotFound) else ""
