"""Systems that move needle and phantom and set the controller, as a scenario of following plans."""

from typing import TYPE_CHECKING

from pydrake.systems.framework import System

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.probe_controller import ProbeControllerParameters
from sonoservo.systems.control.operator_settings import OperatorSettings
from sonoservo.systems.control.scheduled_settings import ScheduledSettings
from sonoservo.systems.display.console.controls import Control, controller_controls
from sonoservo.systems.display.console.operator_panel import OperatorPanel
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.phantom_motion import phantom_trajectory

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console


def planned_sources(
    scenario: FollowingScenario, insertion: Insertion, console: "Console | None" = None
) -> dict[str, System]:
    """Return the sources of a scenario, by name: phantom_motion, hand and controller_settings.

    With a console, there is also an operator_panel, and its operator may change the controller's
    gain and force beside the planned changes.
    """
    schedule = scenario.controller_schedule
    settings: dict[str, System] = {"controller_settings": ScheduledSettings(schedule=schedule)}
    if console is not None:
        controls = settings_controls(scenario.controller)
        settings = {
            "operator_panel": OperatorPanel(controls=controls, inputs=console.controls),
            "controller_settings": OperatorSettings(schedule=schedule),
        }
    return {
        "phantom_motion": PhantomMotion(
            trajectory=phantom_trajectory(scenario.phantom_motion, scenario.station.X_WT)
        ),
        "hand": Hand(insertion=insertion),
        **settings,
    }


def settings_controls(controller: ProbeControllerParameters) -> list[Control]:
    """Return the sliders of a controller's gain and force."""
    start = controller.settings
    return controller_controls(
        gain=start.gain,
        force=start.force,
        min_force=controller.force.touch_force + 0.1,
        max_force=min(5.0, 0.8 * controller.guards.max_force),
    )
