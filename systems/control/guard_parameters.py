"""Parameters of the guard between controller and arm."""

from dataclasses import dataclass, field

import numpy as np

from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive


@dataclass(kw_only=True)
class WristSensorLimits:
    """Limits within which the wrist sensor's samples are plausible.

    Parameters
    ----------
    max_force, max_torque
        Largest component that the sensor can measure, in N and N m. A sample that reaches it is out
        of range or saturated.
    max_jump
        Largest change of a component of the force between two samples, in N.
    max_step
        Largest such change of a steady force, in N. The force of a contact that grows faster goes
        on growing; after a step of the sensor, it does not.
    max_pull
        Largest force away from the body, in N. Contact can only push, so more pull is a bias. After
        a jump, a larger force either way is not believed until the probe is free.
    frozen_after
        Time after which an unchanged sample counts as frozen, in s, because every real sensor has
        noise. It must be longer than the sensor's period. Zero switches the check off, as a sensor
        without noise requires.
    dead_below
        Force in N and torque in N m below which all components of a sample are noise.
    dead_after
        Time for which all samples must be so small, and their mean a fifth of it, until the sensor
        counts as dead, in s. Zero switches the check off, which a force of just the probe's weight
        requires: the sensor then bears nothing.
    confirmed_after
        Time for which samples must be implausible until the sensor counts as faulty, in s. Shorter
        glitches are ignored.
    settling_time
        Time for which samples must be plausible until the sensor is believed again, in s.
    """

    max_force: float = 60.0
    max_torque: float = 20.0
    max_jump: float = 8.0
    max_step: float = 2.0
    max_pull: float = 1.5
    frozen_after: float = 0.05
    dead_below: float = 0.1
    dead_after: float = 0.15
    confirmed_after: float = 0.02
    settling_time: float = 0.1

    def __post_init__(self) -> None:
        require_positive(
            max_force=self.max_force,
            max_torque=self.max_torque,
            max_jump=self.max_jump,
            max_step=self.max_step,
            max_pull=self.max_pull,
            dead_below=self.dead_below,
        )
        require_not_negative(
            frozen_after=self.frozen_after,
            dead_after=self.dead_after,
            confirmed_after=self.confirmed_after,
            settling_time=self.settling_time,
        )


@dataclass(kw_only=True)
class GuardParameters:
    """Limits of the guard, and how it retreats and resumes.

    Parameters
    ----------
    enabled
        Whether the guard acts. Without it, every command reaches the arm.
    max_force
        Contact force at which the probe retreats, in N.
    surface
        (3,) point on the surface of the body at rest, in W, in m. If empty, it is that of the
        station's phantom as configured; the guard never knows the phantom's true pose. Without a
        station, an empty list leaves workspace and depth unguarded.
    max_depth
        Largest depth of the probe's face below the height of that point, in m.
    max_rise
        Largest height above that point at which the body can be felt, in m. A force that is felt
        higher up counts as a bias of the sensor.
    workspace_min, workspace_max
        (3,) corners of the box in which the probe's face may be, along the axes of W and relative
        to that point, in m.
    max_tilt_deg
        Largest angle between the probe's axis and `kinematics.axis`, in deg.
    max_speed, max_acceleration
        Highest speed of the probe's face, in m/s, and highest mean acceleration over 20 ms, in
        m/s^2.
    max_joint_acceleration
        Highest mean acceleration of a joint over 20 ms, in rad/s^2. The limits of the joints'
        positions and speeds are those of the arm.
    max_pose_error
        Largest distance between the measured and the commanded position of the probe, in m.
    pose_frozen_after
        Time after which an unchanged measured pose counts as frozen, in s. The probe is stopped if
        it was commanded to move meanwhile; at rest a frozen pose does no harm and is only noted.
        Zero switches the check off.
    retreat_speed, retreat_acceleration
        Speed and acceleration of a retreat along the probe's axis, in m/s and m/s^2.
    clearance
        Shortest distance of a retreat, in m. A retreat from too much force continues until the
        contact is lost.
    max_retreat
        Longest distance of a retreat, in m.
    resume_after
        Time without a cause to stop after which the controller commands again, in s.
    wrist_sensor
        Limits of plausible samples.
    """

    enabled: bool = True
    max_force: float = 10.0
    surface: list[float] = field(default_factory=list)
    max_depth: float = 0.02
    max_rise: float = 0.06
    workspace_min: list[float] = field(default_factory=lambda: [-0.25, -0.25, -0.1])
    workspace_max: list[float] = field(default_factory=lambda: [0.25, 0.25, 0.12])
    max_tilt_deg: float = 30.0
    max_speed: float = 0.15
    max_acceleration: float = 6.0
    max_joint_acceleration: float = 40.0
    max_pose_error: float = 0.01
    pose_frozen_after: float = 0.1
    retreat_speed: float = 0.3
    retreat_acceleration: float = 5.0
    clearance: float = 0.02
    max_retreat: float = 0.15
    resume_after: float = 0.25
    wrist_sensor: WristSensorLimits = field(default_factory=WristSensorLimits)

    def __post_init__(self) -> None:
        require(0 < self.max_force <= 20, "max_force", self.max_force, "above 0 and at most 20 N")
        finite = bool(np.isfinite(self.surface).all())
        require(
            len(self.surface) in (0, 3) and finite,
            "surface",
            self.surface,
            "three coordinates in m, or empty",
        )
        for name in ("workspace_min", "workspace_max"):
            corner = getattr(self, name)
            good = len(corner) == 3 and bool(np.isfinite(corner).all())
            require(good, name, corner, "three coordinates in m")
        below = bool(np.less(self.workspace_min, self.workspace_max).all())
        require(below, "workspace_min", self.workspace_min, "below workspace_max along each axis")
        require(0 < self.max_tilt_deg <= 90, "max_tilt_deg", self.max_tilt_deg, "from 0 to 90 deg")
        require_positive(
            max_depth=self.max_depth,
            max_rise=self.max_rise,
            max_speed=self.max_speed,
            max_acceleration=self.max_acceleration,
            max_joint_acceleration=self.max_joint_acceleration,
            max_pose_error=self.max_pose_error,
            retreat_speed=self.retreat_speed,
            retreat_acceleration=self.retreat_acceleration,
            clearance=self.clearance,
            max_retreat=self.max_retreat,
        )
        require_not_negative(
            resume_after=self.resume_after, pose_frozen_after=self.pose_frozen_after
        )
