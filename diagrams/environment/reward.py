"""Reward of following a needle, from ground truth, and the ends of an episode."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import PassThrough

from sonoservo.systems.control.controller_schedule import ControllerSchedule, ScheduledSettings


@dataclass(frozen=True)
class RewardParameters:
    """Scales of the reward's terms, and the limits that end an episode.

    Parameters
    ----------
    length, angle
        Distance in m and angle in rad from the image at which a term has fallen to half.
    force
        Wanted contact force, and the error at which its term has fallen to half, in N.
    max_force
        Contact force in N above which an episode ends.
    lost_after
        Time in s after which an episode ends whose needle has left the field of view.
    reached
        Largest offset in m, and angle in rad, at which the needle counts as reached.
    reached_after
        Time in s for which it must stay so at the end of the insertion.
    """

    length: float = 5e-3
    angle: float = float(np.deg2rad(10))
    force: tuple[float, float] = (2.0, 1.0)
    max_force: float = 10.0
    lost_after: float = 3.0
    reached: tuple[float, float] = (1e-3, float(np.deg2rad(1)))
    reached_after: float = 1.0


def reward_terms(
    features: NDArray[np.float64], force: float, visible: bool, parameters: RewardParameters
) -> dict[str, float]:
    """Return the reward's terms, 0 to 1 each, of true features in m and rad and a force in N."""
    there = bool(np.isfinite(features).all()) and visible
    x, z, theta = features if there else np.full(3, np.inf)
    wanted, half = parameters.force
    return {
        "centred": _falling(np.hypot(x, z), parameters.length),
        "aligned": _falling(theta, parameters.angle),
        "in_view": float(there),
        "pressed": _falling(force - wanted, half),
    }


def _falling(error: float, half: float) -> float:
    return float(1 / (1 + (error / half) ** 2))


@dataclass(frozen=True)
class ActionScale:
    """Scale between an action, four numbers from -1 to 1, and what it commands."""

    speed: float = 0.03  # largest v_x and v_z, in m/s
    angular_speed: float = float(np.deg2rad(20))  # largest omega_y, in rad/s
    force: tuple[float, float] = (1.0, 4.0)  # smallest and largest target, in N

    def command(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float]:
        """Return the velocity (v_x, v_z, omega_y) in m/s and rad/s, and the force in N."""
        bounded = np.clip(np.asarray(action, float), -1, 1)
        velocity = bounded[:3] * [self.speed, self.speed, self.angular_speed]
        low, high = self.force
        return velocity, float(low + 0.5 * (bounded[3] + 1) * (high - low))

    def action(self, velocity: NDArray[np.float64], force: float) -> NDArray[np.float32]:
        """Return the action that commands a velocity and a force, within what it can."""
        low, high = self.force
        scaled = [*(velocity / [self.speed, self.speed, self.angular_speed]),
                  2 * (force - low) / (high - low) - 1]  # fmt: skip
        return np.clip(scaled, -1, 1).astype(np.float32)


def MakeCommandedSettings(*, schedule: ControllerSchedule) -> Diagram:
    """Make the controller's settings, in which the agent commands the force.

    .. pydrake_system::

        name: controller_settings
        output_ports:
        - gain
        - force_target

    The force is fixed at the input of the subsystem ``agent_force``.

    Parameters
    ----------
    schedule
        Gain of the servo over time, whose velocity the agent may request.
    """
    builder = DiagramBuilder()
    settings = builder.AddNamedSystem("scheduled", ScheduledSettings(schedule=schedule))
    force = builder.AddNamedSystem("agent_force", PassThrough(1))
    builder.ExportOutput(settings.GetOutputPort("gain"), "gain")
    builder.ExportOutput(force.get_output_port(), "force_target")
    made = builder.Build()
    made.set_name("controller_settings")
    return made
