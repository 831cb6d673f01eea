"""The leaf that keeps a probe moving while its tracker has found nothing."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from sonoservo.diagrams.experiments.following_events import tracker_events
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import evaluate

_REACH = np.array([0.025, 0.012])
"""Half width of the path along X and Y of the phantom, in m."""

_PERIODS = np.array([31.0, 23.0, 37.0])
"""Periods of the motion along X and Y and of the turn, in s."""

_TURN = np.deg2rad(20)
"""Largest turn from the probe's first direction, in rad."""

_DEPTH, _LENGTH = 0.045, 0.06
"""Depth of the imagined tip below the phantom's top, and length of the imagined needle, in m."""


class SearchPath(LeafSystem):
    """Outputs a tracker's estimate while it follows something, else an imagined needle that moves.

    .. pydrake_system::

        name: SearchPath
        input_ports:
        - tracked
        output_ports:
        - estimate

    Both are NeedleEstimates. The imagined needle lies 45 mm below the phantom and moves to and fro
    at up to 6 mm/s, so that a servo that follows the output moves the probe over the phantom.

    Parameters
    ----------
    scenario
        Scenario with the place of phantom and probe.
    start
        Time in s until which the tracker's estimate is handed on as it is.
    """

    def __init__(self, *, scenario: FollowingScenario, start: float) -> None:
        super().__init__()
        self._station, self._start = scenario.station, start
        self.DeclareAbstractInputPort("tracked", Value[object]())
        self.DeclareAbstractOutputPort("estimate", lambda: Value[object](), self._calc_estimate)

    def _calc_estimate(self, context: Context, output: Value) -> None:
        tracked = evaluate(self, context, "tracked", NeedleEstimate)
        follows = bool(tracked) and tracked.mode in (TrackingMode.TRACKING, TrackingMode.COASTING)
        time = context.get_time()
        imagined = not follows and time >= self._start
        output.set_value(self._imagined(time, tracked.volume_time) if imagined else tracked)

    def _imagined(self, time: float, volume_time: float) -> NeedleEstimate:
        probe = self._station.probe
        x, y, turn = np.sin(2 * np.pi * (time - self._start) / _PERIODS) * [*_REACH, _TURN]
        tip = np.array([probe.x + x, probe.y + y, -_DEPTH])
        heading = np.deg2rad(probe.yaw_deg) + turn
        entry = tip - _LENGTH * np.array([np.cos(heading), np.sin(heading), 0.0])
        points = self._station.X_WT.multiply(np.array([entry, tip]).T).T
        return NeedleEstimate(
            mode=TrackingMode.TRACKING,
            time=time,
            curve=NeedleCurve(points),
            velocity=np.zeros((2, 3)),
            covariance=1e-8 * np.eye(12),
            volume_time=volume_time,
        )


def MakeSearchingTracker(*, scenario: FollowingScenario, start: float) -> Diagram:
    """Make a scenario's tracker behind a `SearchPath`.

    .. pydrake_system::

        name: searching_tracker
        input_ports:
        - volume
        output_ports:
        - estimate

    Parameters
    ----------
    scenario
        Scenario with tracker, seed, and place of phantom and probe.
    start
        Time in s from which the probe searches.
    """
    tracker = MakeNeedleTracker(
        parameters=scenario.tracker, seed=draw_seeds(scenario).tracker, **tracker_events(scenario)
    )
    builder = DiagramBuilder()
    builder.AddNamedSystem("needle_tracker", tracker)
    path = builder.AddNamedSystem("search_path", SearchPath(scenario=scenario, start=start))
    builder.Connect(tracker.GetOutputPort("estimate"), path.GetInputPort("tracked"))
    builder.ExportInput(tracker.GetInputPort("volume"), "volume")
    builder.ExportOutput(path.GetOutputPort("estimate"), "estimate")
    made = builder.Build()
    made.set_name("searching_tracker")
    return made
