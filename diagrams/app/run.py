"""One run of a scenario, from the first step to its output files."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System
from rich.console import Console as Terminal

from sonoservo.diagrams.app.kept_runs.kept_run import KeptRun, refusing
from sonoservo.diagrams.app.own_tracker import OwnTracker, as_system
from sonoservo.diagrams.app.pages.pacer import Pacer
from sonoservo.diagrams.app.run_result import RunResult
from sonoservo.diagrams.app.terminal import Progress, run_progress
from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.following_scene import tracker_events
from sonoservo.diagrams.experiments.registry import (
    experiment_class,
    load_scenario,
    make_experiment,
)
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.display.console.readings import Sample
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.evaluation.reports.movie import check_movie
from sonoservo.systems.files.refusals import ConfigurationError

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console


def run(
    scenario: Scenario | str | Path,
    *,
    changes: Mapping[str, Any] | Sequence[str] | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    meshcat: Meshcat | None = None,
    console: "Console | None" = None,
    replay: bool = False,
    movie: str | Path | None = None,
    tracker: OwnTracker | None = None,
    record: str | Path | None = None,
    record_sweeps: bool = False,
    explain: bool = False,
    observers: Mapping[str, System] | None = None,
    begin: Callable[[], None] | None = None,
    after_step: Callable[[Experiment[Any]], None] | None = None,
    progress: bool | Terminal | None = None,
) -> RunResult:
    """Run a scenario of any experiment to its end, or until it is interrupted from the keyboard.

    Parameters
    ----------
    scenario
        Scenario of any experiment, the name of a built-in one, or the path of a YAML file.
    changes, seed
        Fields to change, such as ``{"imaging.gain": 0.5}``, and the seed; see `load_scenario`.
    out
        Folder for scenario.yaml, summary.json, log.npz, plots, report.html and, with a Meshcat,
        replay.html; None writes nothing.
    meshcat
        Meshcat that draws the world, if any. With it, the run is limited to real time.
    console
        Console that shows and controls the run, if any: its pages may pause it, step through it,
        change its speed (real time at first) and the controller's settings, and end it.
    replay
        Whether to write replay.html even without a Meshcat.
    movie
        File for a movie of the run, ``NAME.gif`` or ``NAME.mp4``; None writes none.
    tracker
        Tracker that replaces the scenario's: a system (see `FollowingExperiment`), a function from
        the next `Volume` to the `NeedleEstimate` after it, or ``"module:factory"`` of either, as
        for the benchmark.
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
    begin
        Function called before the first step, once it is known that the scenario can be carried
        out.
    after_step
        Function called after every volume or slice with the experiment, which provides the time and
        the tracker's status.
    progress
        Whether to show a progress bar, or the terminal to show it in; by default, in a terminal and
        in a notebook only.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out, its experiment does not have an option, or there is
        no folder for what is to be explained.
    """
    scenario = load_scenario(scenario, changes=changes, seed=seed)
    out, movie, record = (None if each is None else Path(each) for each in (out, movie, record))
    if explain and out is None:
        raise ConfigurationError("explain: there is no folder to keep explanations in; give out")
    if replay and out is None:
        raise ConfigurationError("replay: there is no folder to write replay.html in; give out")
    if movie is not None:
        check_movie(movie)
    shown = bool(meshcat or console or observers)
    possible = experiment_class(scenario.experiment).options
    fed = "console" in possible
    if console is not None and not fed:
        console.say(without=["slices", "strips", "readings"])
    bar = progress_bar(scenario, progress)
    with ExitStack() as stack:
        if replay and meshcat is None:
            meshcat = open_meshcat(stack.enter_context(Site()))
        if tracker is not None and "tracker" in possible:
            tracker = as_system(tracker, **tracker_events(scenario))
        with refusing(scenario):
            experiment = make_experiment(
                scenario,
                meshcat=meshcat,
                console=console if fed else None,
                tracker=tracker,
                record=record,
                record_sweeps=record_sweeps,
                explain=out if explain else None,
                pictures="pictures" in possible and (out is not None or movie is not None),
                observers=observers,
            )
        pacer = Pacer(console) if console is not None else None
        kept = KeptRun(experiment, out=out, meshcat=meshcat, movie=movie, console=console)

        def note(experiment: Experiment[Any]) -> None:
            kept.go_on()
            if bar is not None:
                bar.show(experiment.time, experiment.status)
            if after_step is not None:
                after_step(experiment)
            if console is not None and not fed:
                console.add(Sample(time=experiment.time, reason=experiment.status))
            if pacer is not None and pacer.wait(experiment.time):
                experiment.set_speed(pacer.speed)

        return kept.carry_out(lambda: experiment.run(note, real_time=shown), begin=begin, bar=bar)


def progress_bar(scenario: Scenario, wanted: bool | Terminal | None) -> Progress | None:
    """Return a progress bar, if it is wanted or, by default, if somebody sees it."""
    terminal = wanted if isinstance(wanted, Terminal) else Terminal()
    if wanted is None:
        wanted = terminal.is_terminal and sys.stdout.isatty()
        if terminal.is_jupyter:  # where a bar is a widget
            wanted = find_spec("ipywidgets") is not None
    return run_progress(terminal, scenario) if wanted else None
