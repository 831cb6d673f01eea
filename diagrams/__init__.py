"""How blocks are wired: station, tracker, controller, experiment; scenarios, command line.

>>> from sonoservo.diagrams import load_scenario, run
>>> result = run(load_scenario("chatelain2013_fig5", seed=1))
>>> result.summary["servo"]["at_rest"]
"""

from sonoservo.diagrams.app.locate import LocatedNeedle, locate, locate_in
from sonoservo.diagrams.app.run import RunResult, run
from sonoservo.diagrams.app.track import TrackedRecording, track_recording, tracker_parameters
from sonoservo.diagrams.experiment import Experiment, tracker_events
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker, track
from sonoservo.diagrams.probe_controller import MakeProbeController
from sonoservo.diagrams.scenario import Scenario, list_scenarios, load_scenario
from sonoservo.diagrams.trackers import Chatelain2013TrackerParameters, Zhao2012TrackerParameters

__all__ = [
    "Chatelain2013TrackerParameters",
    "Experiment",
    "LocatedNeedle",
    "MakeNeedleTracker",
    "MakeProbeController",
    "RunResult",
    "Scenario",
    "TrackedRecording",
    "Zhao2012TrackerParameters",
    "list_scenarios",
    "load_scenario",
    "locate",
    "locate_in",
    "run",
    "track",
    "track_recording",
    "tracker_events",
    "tracker_parameters",
]
