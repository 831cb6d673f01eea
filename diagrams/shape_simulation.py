"""One run of needle shape prediction, from the first slice to the files that remain."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from sonoservo.diagrams.shape_experiment import ShapeExperiment
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.systems.estimation.needle_shape import NeedleShape
from sonoservo.systems.localization.cross_section import CrossSection
from sonoservo.systems.recording.files import write_atomically, write_json
from sonoservo.systems.recording.plots import png
from sonoservo.systems.recording.replay import save_replay
from sonoservo.systems.recording.report import write_report
from sonoservo.systems.recording.shape_log import ShapeLog, write_shape_log
from sonoservo.systems.recording.shape_metrics import summarize_shape
from sonoservo.systems.recording.shape_plots import plot_shape
from sonoservo.systems.typed_yaml import ConfigurationError
from sonoservo.systems.values import NotFound


@dataclass(frozen=True)
class ShapeResult:
    """What is left of a run.

    Parameters
    ----------
    summary
        Figures, as in summary.json.
    log
        A row for each slice.
    shape
        What the estimator believes at the end.
    """

    summary: dict[str, Any]
    log: ShapeLog
    shape: NeedleShape | NotFound


def predict_shape(
    scenario: ShapeScenario,
    *,
    out: Path | None = None,
    meshcat: Meshcat | None = None,
    after_slice: Callable[[float, CrossSection | NotFound], None] | None = None,
) -> ShapeResult:
    """Run a scenario to its end, or until it is interrupted from the keyboard.

    Parameters
    ----------
    scenario
        What is to happen.
    out
        Folder for scenario.yaml, summary.json, log.npz, shape.png, report.html and, with a
        Meshcat, replay.html; None keeps nothing.
    meshcat
        Where to draw. The run then goes no faster than real time.
    after_slice
        Called after every slice, with the simulated time in s and the cross-section.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out.
    """
    try:
        experiment = ShapeExperiment(scenario, meshcat)
    except (ValueError, FileNotFoundError) as error:
        raise ConfigurationError(f"{scenario.name}: {error}") from error
    if out is not None:
        write_atomically(out / "scenario.yaml", scenario.to_yaml())
    if meshcat is not None:
        meshcat.StartRecording(set_visualizations_while_recording=True)
    started = time.perf_counter()
    interrupted = False
    try:
        experiment.run(after_slice, real_time=meshcat is not None)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        # Whatever happened, what was logged is not lost.
        log = experiment.log()
        if out is not None:
            write_shape_log(out / "log.npz", log)
    wall = time.perf_counter() - started
    shape = experiment.shape
    summary = {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "version": version("sonoservo"),
        "estimator": scenario.estimator,
        "interrupted": interrupted,
        "simulated_s": experiment.time,
        "wall_s": wall,
        "real_time_factor": experiment.time / wall,
        **summarize_shape(log, shape),
    }
    if out is not None:
        _write_results(out, scenario, summary, log, shape, meshcat)
    return ShapeResult(summary, log, shape)


def _write_results(
    out: Path,
    scenario: ShapeScenario,
    summary: dict[str, Any],
    log: ShapeLog,
    shape: NeedleShape | NotFound,
    meshcat: Meshcat | None,
) -> None:
    write_json(out / "summary.json", summary)
    if meshcat is not None:
        save_replay(meshcat, out / "replay.html")
    picture = png(plot_shape(log, shape)) if len(log.depth) > 1 else None
    if picture is not None:
        write_atomically(out / "shape.png", picture)
    write_report(
        out / "report.html",
        summary,
        {"path, measured, true and predicted": picture} if picture else {},
        command=f"sonoservo run {out / 'scenario.yaml'}",
        paper=scenario.published_figures,
        replay="replay.html" if meshcat is not None else "",
    )
