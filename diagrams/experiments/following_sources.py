"""Systems that move needle and phantom and set the controller, as a scenario of following plans."""

from pydrake.systems.framework import System

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.systems.control.controller_schedule import ControllerSchedule
from sonoservo.systems.control.scheduled_settings import ScheduledSettings
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.phantom_motion import phantom_trajectory


def planned_sources(scenario: FollowingScenario, insertion: Insertion) -> dict[str, System]:
    """Return the sources of a scenario, by name: phantom_motion, hand and controller_settings."""
    schedule = ControllerSchedule(scenario.controller.settings, tuple(scenario.controller_changes))
    return {
        "phantom_motion": PhantomMotion(
            trajectory=phantom_trajectory(scenario.phantom_motion, scenario.station.X_WT)
        ),
        "hand": Hand(insertion=insertion),
        "controller_settings": ScheduledSettings(schedule=schedule),
    }
