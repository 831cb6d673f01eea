"""A run that is also written as a log for a viewer: Rerun or Foxglove."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.assembly import assemble_arm
from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.systems.display.shapes import sector_edges
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.viewer_logs import (
    Surroundings,
    open_viewer_log,
    write_run,
    write_volume,
)
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

Floats = NDArray[np.float64]


class ViewedRun:
    """Writes the volumes of a run as they come, and the rest of its log at its end.

    Without a path it writes nothing; without a scenario of following, as for recorded volumes,
    neither arm nor sector is drawn. ConfigurationError if the suffix is not allowed, its package is
    missing, or the scenario is of another experiment.
    """

    def __init__(self, path: Path | None, scenario: Scenario | None = None) -> None:
        self._log = None
        self._scenario: FollowingScenario | None = None
        if path is None:
            return
        if scenario is not None:
            self._scenario = require_scenario(scenario, FollowingScenario)
        self._log = open_viewer_log(path)

    def __call__(self, experiment: Experiment[Any]) -> None:
        """Write the newest volume with its slices."""
        if self._log is not None and isinstance(experiment, FollowingExperiment):
            volume = experiment.evaluate(experiment.scan_converter, "volume")
            if isinstance(volume, Volume):
                self.show(volume, experiment.estimate)

    def show(self, volume: Volume, estimate: NeedleEstimate) -> None:
        """Write a volume, and its slices through the estimated needle."""
        if self._log is not None:
            write_volume(self._log, volume, estimate)

    def end(self, log: Any) -> None:
        """Write the run's log, and give the file its final name."""
        if self._log is None:
            return
        assert isinstance(log, RunLog)
        surroundings = Surroundings()
        if self._scenario is not None:
            transducer, imaging = load_transducer(self._scenario.probe), self._scenario.imaging
            edges = sector_edges(sweep_geometry(transducer, imaging))
            surroundings = Surroundings(edges, _arm_points(self._scenario))
        write_run(self._log, log, surroundings)
        self._log.close()


def _arm_points(scenario: FollowingScenario) -> Callable[[Floats], Floats]:
    """Return a function from (n, joints) positions to the (n, m, 3) origins of the arm's bodies."""
    plant = assemble_arm(scenario.station.arm, scenario.probe).plant
    context = plant.CreateDefaultContext()
    bodies = [plant.get_joint(index).child_body() for index in plant.GetJointIndices()]

    def points(positions: Floats) -> Floats:
        rows = []
        for each in positions:
            plant.SetPositions(context, each)
            poses = (plant.EvalBodyPoseInWorld(context, body) for body in bodies)
            rows.append([pose.translation() for pose in poses])
        return np.array(rows)

    return points
