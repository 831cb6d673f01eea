"""One run of needle shape prediction, from the first slice to the files that remain."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from sonoservo.diagrams.app.kept_run import KeptRun, refusing
from sonoservo.diagrams.shape_experiment import ShapeExperiment
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.systems.evaluation.shape_log import ShapeLog, write_shape_log
from sonoservo.systems.evaluation.shape_metrics import summarize_shape
from sonoservo.systems.evaluation.shape_plots import plot_shape
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape


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
    with refusing(scenario):
        experiment = ShapeExperiment(scenario, meshcat)
    kept = KeptRun(
        scenario, lambda path: write_shape_log(path, experiment.log()), out=out, meshcat=meshcat
    )

    def note(simulated: float, found: CrossSection | NotFound) -> None:
        kept.go_on()
        if after_slice is not None:
            after_slice(simulated, found)

    with kept:
        experiment.run(note, real_time=meshcat is not None)
    log, shape = experiment.log(), experiment.shape
    figures = {"estimator": scenario.estimator, **summarize_shape(log, shape)}
    summary = kept.summary(experiment.time, figures)
    if out is not None:
        plots = {}
        if len(log.depth) > 1:
            plots["shape.png"] = ("path, measured, true and predicted", plot_shape(log, shape))
        kept.write(summary, plots, scenario.published_figures)
    return ShapeResult(summary, log, shape)
