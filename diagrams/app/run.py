"""One run of a scenario, from the first volume to the files that remain."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System

from sonoservo.diagrams.app.kept_run import KeptRun, refusing
from sonoservo.diagrams.experiment import Experiment
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.evaluation.metrics import MetricsParameters, summarize
from sonoservo.systems.evaluation.plots import plot_errors, plot_run
from sonoservo.systems.evaluation.run_log import RunLog, write_log
from sonoservo.systems.signals.needle_estimate import NeedleEstimate

if TYPE_CHECKING:
    from sonoservo.systems.display.monitor.monitor import Monitor


@dataclass(frozen=True)
class RunResult:
    """What is left of a run.

    Parameters
    ----------
    summary
        Figures, as in summary.json.
    log
        Everything that was logged.
    """

    summary: dict[str, Any]
    log: RunLog


def run(
    scenario: Scenario,
    *,
    out: Path | None = None,
    tracker: System | None = None,
    meshcat: Meshcat | None = None,
    monitor: "Monitor | None" = None,
    after_volume: Callable[[float, NeedleEstimate], None] | None = None,
    record: Path | None = None,
    record_sweeps: bool = False,
    observers: Mapping[str, System] | None = None,
) -> RunResult:
    """Run a scenario to its end, or until it is interrupted from the keyboard.

    Parameters
    ----------
    scenario
        What is to happen.
    out
        Folder for scenario.yaml, summary.json, log.npz, plots, report.html and, with a Meshcat,
        replay.html; None keeps nothing.
    tracker
        One's own, in place of the scenario's; see `Experiment`.
    meshcat, monitor
        Where to draw the world, and where to show the volumes. The run then goes no faster than
        real time.
    after_volume
        Called after every volume, with the simulated time in s and the estimate.
    record
        Where to record the volumes as they come, ``NAME.seq.nrrd``, and the truth beside them; None
        records none. What was recorded before an interruption stays.
    record_sweeps
        Whether to record the sweeps too, as acquired.
    observers
        Systems that look on; see `Experiment`. The run then goes no faster than real time.

    Returns
    -------
    The figures and the log.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out.
    """
    with refusing(scenario):
        experiment = Experiment(
            scenario,
            meshcat,
            tracker=tracker,
            monitor=monitor,
            record=record,
            record_sweeps=record_sweeps,
            observers=observers,
        )
    kept = KeptRun(
        scenario, lambda path: write_log(path, experiment.log()), out=out, meshcat=meshcat
    )

    def note(simulated: float, estimate: NeedleEstimate) -> None:
        kept.go_on()
        if after_volume is not None:
            after_volume(simulated, estimate)

    with kept:
        try:
            experiment.run(note, real_time=bool(meshcat or monitor or observers))
        finally:
            experiment.close()
    return write_results(kept, experiment, scenario)


def write_results(kept: KeptRun, experiment: Experiment, scenario: Scenario) -> RunResult:
    """Sum up a run that has ended, and write what is to be kept of it.

    Parameters
    ----------
    kept
        The run.
    experiment
        What was simulated.
    scenario
        What happened.
    """
    log = experiment.log()
    changed = any(change.force is not None for change in scenario.controller_changes)
    target = None if changed else scenario.controller.force.force
    figures = summarize(log, MetricsParameters(force_target=target))
    summary = kept.summary(experiment.time, figures)
    plots = {
        "run.png": ("features, tip, probe, force", plot_run(log, target)),
        "errors.png": ("errors", plot_errors(log)),
    }
    kept.write(summary, plots, scenario.published)
    return RunResult(summary, log)
