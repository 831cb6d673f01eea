"""One run of a scenario, from the first step to its output files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System

from sonoservo.diagrams.app.kept_run import KeptRun, refusing
from sonoservo.diagrams.app.pacer import Pacer
from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.registry import experiment_class, make_experiment
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.display.console.readings import Sample
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.files.claims import claim_folder
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console


@dataclass(frozen=True)
class RunResult:
    """Results of a run.

    Parameters
    ----------
    summary
        Figures, as in summary.json.
    log
        Log of the run; its class depends on the experiment.
    labels
        Label of each figure of the summary that tables show, by its dotted path.
    results
        Further results of the experiment, by name: shape prediction has the last `shape`.
    failure
        Error of the first file that could not be written; None if all were.
    """

    summary: dict[str, Any]
    log: Any
    labels: Mapping[str, str]
    results: Mapping[str, Any] = field(default_factory=dict)
    failure: OSError | None = None


def run(
    scenario: Scenario,
    *,
    out: Path | None = None,
    meshcat: Meshcat | None = None,
    console: "Console | None" = None,
    tracker: System | None = None,
    record: Path | None = None,
    record_sweeps: bool = False,
    explain: bool = False,
    observers: Mapping[str, System] | None = None,
    after_step: Callable[[Experiment[Any]], None] | None = None,
) -> RunResult:
    """Run a scenario of any experiment to its end, or until it is interrupted from the keyboard.

    Parameters
    ----------
    scenario
        Scenario of any experiment.
    out
        Folder for scenario.yaml, summary.json, log.npz, plots, report.html and, with a Meshcat,
        replay.html; None writes nothing.
    meshcat
        Meshcat that draws the world, if any. With it, the run is limited to real time.
    console
        Console that shows and controls the run, if any: its pages may pause it, step through it,
        change its speed (real time at first) and the controller's settings, and end it.
    tracker
        Custom tracker that replaces the scenario's; see `FollowingExperiment`.
    record
        File to which the volumes are recorded one by one, ``NAME.seq.nrrd``, with the truth beside
        it; None records nothing. The recording survives an interruption.
    record_sweeps
        Whether to also record the sweeps as acquired.
    explain
        Whether to keep, in the folder's subfolder ``explanation``, what the tracker looked at
        around a loss; see `ExplanationRecorder`.
    observers
        Observing systems; see `FollowingExperiment`. With them, the run is also limited to real
        time.
    after_step
        Function called after every volume or slice with the experiment, which provides the time and
        the tracker's status.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out, its experiment does not have an option, or there is
        no folder for what is to be explained.
    """
    if explain and out is None:
        raise ConfigurationError("explain: there is no folder to keep explanations in; give out")
    has_feed = "console" in experiment_class(scenario.experiment).options
    if console is not None and not has_feed:
        console.say(without=["slices", "strips", "readings"])
    with refusing(scenario):
        experiment = make_experiment(
            scenario,
            meshcat=meshcat,
            console=console if has_feed else None,
            tracker=tracker,
            record=record,
            record_sweeps=record_sweeps,
            explain=out if explain else None,
            observers=observers,
        )
    pacer = Pacer(console) if console is not None else None

    def save(path: Path) -> None:
        write_log(path, experiment.log())
        if console is not None:  # which may have changed it
            write_atomically(path.with_name("scenario.yaml"), experiment.happened().to_yaml())

    kept = KeptRun(scenario, save, out=out, meshcat=meshcat)

    def note(experiment: Experiment[Any]) -> None:
        kept.go_on()
        if after_step is not None:
            after_step(experiment)
        if console is not None and not has_feed:
            console.add(Sample(time=experiment.time, reason=experiment.status))
        if pacer is not None and pacer.wait(experiment.time):
            experiment.set_speed(pacer.speed)

    with claim_folder(out):
        with kept:
            try:
                experiment.run(note, real_time=bool(meshcat or console or observers))
            finally:
                experiment.close()
        return finish(kept, experiment)


def finish(kept: KeptRun, experiment: Experiment[Any]) -> RunResult:
    """Summarise a run that has ended, and write its output files.

    Parameters
    ----------
    kept
        Run that has ended.
    experiment
        Its experiment.
    """
    log = experiment.log()
    summary = kept.summary(experiment.time, experiment.summarize(log))
    if kept.out is not None:
        kept.write(summary, experiment.plots(log), experiment.happened().published_figures)
    return RunResult(summary, log, experiment.labels, experiment.results(), kept.unwritten.failure)
