"""Log of a run in which the robot follows a needle."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sonoservo.systems.evaluation.log import Array, Log, column


@dataclass(frozen=True, eq=False, kw_only=True)
class RunLog(Log):
    """Log of a run: n samples at a fixed period, and v volumes, as in the file `log.npz`.

    A value that was not connected or did not exist is NaN, or an empty text. SI units, in the world
    frame W unless a column says otherwise. Only the simulator knows the truth.
    """

    time: Array = column("time of the sample", "s", "n")
    X_WP: Array = column("truth: pose of the probe", "m", "n 4 4")
    measured_X_WP: Array = column("measured pose of the probe", "m", "n 4 4")
    X_WT: Array = column("pose of the phantom", "m", "n 4 4")
    needle_tip: Array = column("truth: the tip; NaN while it is outside the tissue", "m", "n 3")
    needle_entry: Array = column("truth: point where the needle enters the tissue", "m", "n 3")
    needle_points: Array = column("truth: nine evenly spaced points, entry to tip", "m", "n 9 3")
    inserted_length: Array = column("truth: length inside the tissue", "m", "n")
    visible_length: Array = column("truth: length inside the swept sector", "m", "n")
    estimate_mode: Array = column("tracking mode", "", "n", "U")
    estimate_time: Array = column("time for which the estimate holds", "s", "n")
    estimate_tip: Array = column("estimated tip", "m", "n 3")
    estimate_entry: Array = column("estimated entry", "m", "n 3")
    estimate_velocity: Array = column("estimated velocity of the tip", "m/s", "n 3")
    joint_state: Array = column("positions, then velocities, of the arm's joints", "rad", "n 2j")
    contact_force: Array = column("truth: force between probe and phantom", "N", "n")
    wrist_force: Array = column(
        "torque, then force, that the wrist sensor measures", "N m, N", "n 6"
    )
    planar_velocity: Array = column("commanded v_x, v_z, omega_y of the probe in P", "m/s", "n 3")

    guard_state: Array = column("state of the guard between controller and arm", "", "n", "U")
    guard_reason: Array = column("reason why the guard stops the robot at this time", "", "n", "U")
    hold_reason: Array = column(
        "reason why the servo does not follow a tracked needle", "", "n", "U"
    )
    volumes_refused: Array = column("number of volumes refused as implausible so far", "", "n")
    refusal_reason: Array = column("reason why the newest volume was refused", "", "n", "U")

    volume_time: Array = column(
        "middle of the volume's acquisition, by the scanner's clock", "s", "v"
    )
    volume_X_WP: Array = column("measured pose of the probe at that time", "m", "v 4 4")
    volume_true_time: Array = column("truth: middle of the volume's acquisition", "s", "v")
    volume_true_X_WP: Array = column("truth: pose of the probe at that time", "m", "v 4 4")
    volume_seen: Array = column("time at which the log saw its estimate", "s", "v")
    volume_detected: Array = column("True if an insertion was detected", "", "v", "?")
    volume_detection_reason: Array = column("reason if no insertion was detected", "", "v", "U")
    volume_measured_time: Array = column("time of the measured tip", "s", "v")
    volume_measured_tip: Array = column("tip measured in the volume", "m", "v 3")
    volume_measured_entry: Array = column("entry measured in the volume", "m", "v 3")
    volume_inlier_count: Array = column("number of voxels that support the measurement", "", "v")
    volume_inlier_ratio: Array = column("share of these among all candidate voxels", "", "v")
    volume_measurement_reason: Array = column("reason if no needle was measured", "", "v", "U")
    volume_estimate_mode: Array = column("tracking mode after the volume", "", "v", "U")
    volume_estimate_time: Array = column(
        "time for which the estimate after the volume holds", "s", "v"
    )
    volume_estimate_tip: Array = column("estimated tip after the volume", "m", "v 3")
    volume_estimate_entry: Array = column("estimated entry after the volume", "m", "v 3")
    volume_estimate_points: Array = column(
        "entry, middle and tip of the estimated curve after the volume", "m", "v 3 3"
    )
    volume_estimate_velocity: Array = column(
        "estimated velocity of the tip after the volume", "m/s", "v 3"
    )
    volume_estimate_tip_covariance: Array = column(
        "stated covariance of the estimated tip", "m^2", "v 3 3"
    )
    volume_estimate_direction_covariance: Array = column(
        "stated covariance of the direction, entry to tip", "", "v 3 3"
    )
    volume_estimate_velocity_covariance: Array = column(
        "stated covariance of the tip's velocity", "m^2/s^2", "v 3 3"
    )

    compute: Mapping[str, Array] = field(default_factory=dict)
    """Computing time per volume in s, by stage; in the file as `compute_<name>`."""

    @property
    def estimate_direction(self) -> Array:
        """Unit vectors from the estimated entry to the estimated tip, (n, 3), in W."""
        return unit(self.estimate_tip - self.estimate_entry)


def unit(vectors: Array) -> Array:
    """Return (m, 3) vectors divided by their lengths; NaN for a vector of zero length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, np.nan)
