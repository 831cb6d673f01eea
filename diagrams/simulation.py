"""One run of a scenario, from the first volume to the files that remain."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from sonoservo.diagrams.experiment import Experiment
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.estimation.estimate import NeedleEstimate
from sonoservo.systems.recording.files import write_atomically, write_json
from sonoservo.systems.recording.metrics import MetricsParameters, summarize
from sonoservo.systems.recording.plots import plot_errors, plot_run, png
from sonoservo.systems.recording.replay import save_replay
from sonoservo.systems.recording.report import write_report
from sonoservo.systems.recording.run_log import RunLog, write_log
from sonoservo.systems.typed_yaml import ConfigurationError

_SAVE_EVERY = 10.0
"""Wall-clock time in s after which the log is saved again while a run goes on."""


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
    meshcat: Meshcat | None = None,
    after_volume: Callable[[float, NeedleEstimate], None] | None = None,
    record: Path | None = None,
    record_sweeps: bool = False,
) -> RunResult:
    """Run a scenario to its end, or until it is interrupted from the keyboard.

    Parameters
    ----------
    scenario
        What is to happen.
    out
        Folder for scenario.yaml, summary.json, log.npz, plots, report.html and, with a Meshcat,
        replay.html; None keeps nothing.
    meshcat
        Where to draw. The run then goes no faster than real time.
    after_volume
        Called after every volume, with the simulated time in s and the estimate.
    record
        Where to record the volumes as they come, ``NAME.seq.nrrd``, and the truth beside them; None
        records none. What was recorded before an interruption stays.
    record_sweeps
        Whether to record the sweeps too, as acquired.

    Returns
    -------
    The figures and the log.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out.
    """
    try:
        experiment = Experiment(scenario, meshcat, record=record, record_sweeps=record_sweeps)
    except (ValueError, FileNotFoundError) as error:
        raise ConfigurationError(f"{scenario.name}: {error}") from error
    if out is not None:
        write_atomically(out / "scenario.yaml", scenario.to_yaml())
    if meshcat is not None:
        meshcat.StartRecording(set_visualizations_while_recording=True)

    started = saved = time.perf_counter()

    def note(simulated: float, estimate: NeedleEstimate) -> None:
        nonlocal saved
        if out is not None and time.perf_counter() - saved > _SAVE_EVERY:
            write_log(out / "log.npz", experiment.log())
            saved = time.perf_counter()
        if after_volume is not None:
            after_volume(simulated, estimate)

    interrupted = False
    try:
        experiment.run(note, real_time=meshcat is not None)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        # Whatever happened, what was logged is not lost.
        log = experiment.log()
        if out is not None:
            write_log(out / "log.npz", log)
        experiment.close()
    wall = time.perf_counter() - started

    target = scenario.controller.force.force
    summary = {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "version": version("sonoservo"),
        "interrupted": interrupted,
        "wall_s": wall,
        "real_time_factor": experiment.time / wall,
        **summarize(log, MetricsParameters(force_target=target)),
    }
    if out is not None:
        write_json(out / "summary.json", summary)
        if meshcat is not None:
            save_replay(meshcat, out / "replay.html")
        figures = {"features, tip, probe, force": plot_run(log, target), "errors": plot_errors(log)}
        images = {name: png(figure) for name, figure in figures.items()}
        write_atomically(out / "run.png", images["features, tip, probe, force"])
        write_atomically(out / "errors.png", images["errors"])
        write_report(
            out / "report.html",
            summary,
            images,
            command=f"sonoservo run {out / 'scenario.yaml'}",
            paper=scenario.published,
            replay="replay.html" if meshcat is not None else "",
        )
    return RunResult(summary, log)
