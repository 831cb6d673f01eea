"""Times at which a scenario of following looks for volumes, and settings of its recordings."""

from typing import Any

from sonoservo.diagrams.experiments.experiment import INSTANT
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer


def is_irregular(scenario: FollowingScenario, geometry: SweepGeometry) -> bool:
    """Return True if estimates do not come a fixed time after the end of each sweep."""
    parameters = scenario.scanner
    ahead = parameters.clock.offset > 0 or parameters.clock.drift > 0
    busy = scenario.processing_time >= geometry.period
    return busy or ahead or parameters.connection.lateness > 0


def tracker_events(scenario: Scenario) -> dict[str, float]:
    """Return the period and the offset in s of the events at which a tracker looks for a volume.

    There is a new volume at each of them, unless volumes are lost. If they come late, or the
    tracker needs longer than a sweep takes, it looks after every frame; the scanner then withholds
    a volume for the processing time.

    Raises
    ------
    ValueError
        If the scenario's transducer or imaging is not possible.
    """
    scenario = require_scenario(scenario, FollowingScenario)
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    if is_irregular(scenario, geometry):
        return {"period": geometry.frame_period, "offset": geometry.period + 10 * INSTANT}
    return {"period": geometry.period, "offset": geometry.period + scenario.processing_time}


def observer_events(scenario: Scenario) -> dict[str, float]:
    """Return the period and offset in s at which to look for a new volume and its estimate."""
    events = tracker_events(scenario)
    return {"period": events["period"], "offset": events["offset"] + 2 * INSTANT}


def recording_settings(scenario: FollowingScenario) -> dict[str, Any]:
    """Return the settings that a tracker of a scenario's recorded volumes needs."""
    return {"tracker_seed": draw_seeds(scenario).tracker}
