"""Words, plots and pictures of the runs in which a needle's shape is predicted."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.presenter import Presenter, description, needle_words
from sonoservo.diagrams.experiments.shape_prediction_scenario import ShapePredictionScenario
from sonoservo.systems.evaluation.reports.verdict import Verdict
from sonoservo.systems.evaluation.shape.shape_metrics import LABELS, ShapeLog, shape_verdict
from sonoservo.systems.evaluation.shape.shape_plots import (
    OVERLAY_CAPTION,
    SHAPE_CAPTION,
    plot_key_slices,
    plot_shape,
    plot_shape_comparison,
    shape_movie_frames,
)


class ShapePredictionPresenter(Presenter):
    """Presents the runs of a `ShapePredictionExperiment`."""

    labels = LABELS
    overlay_caption = OVERLAY_CAPTION
    overlay = staticmethod(plot_shape_comparison)

    def plots(self, log: ShapeLog) -> dict[str, tuple[str, Figure]]:
        """Return the plot of the paths, if there are at least two slices."""
        if len(log.depth) < 2:
            return {}
        return {"shape.png": (SHAPE_CAPTION, plot_shape(log, self._experiment.shape))}

    def verdict(self, summary: Mapping[str, Any]) -> Verdict:
        """Return the verdict on a run, from its summary."""
        return shape_verdict(summary)

    def words(self) -> list[str]:
        """Return sentences that describe the scenario."""
        return shape_words(self._experiment.scenario)

    def key_frames(self, log: ShapeLog) -> dict[str, Figure]:
        """Return pictures of a run's telling slices, by caption; none unless they were kept."""
        return plot_key_slices(log, self._experiment.slice_pictures)

    def frames(self, log: ShapeLog) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames of a movie, one per slice."""
        return shape_movie_frames(log, self._experiment.slice_pictures, self._experiment.shape)

    @property
    def frame_rate(self) -> float:
        """Slices per second."""
        return float(1 / self._experiment.scenario.period)


def shape_words(scenario: ShapePredictionScenario) -> list[str]:
    """Return sentences that describe a scenario."""
    turned = ", ".join(f"{1e3 * each:g}" for each in scenario.rotations)
    bevel = f"Its bevel is turned at {turned} mm." if turned else "Its bevel is never turned."
    seen = scenario.observe_until
    used = "all of them" if seen is None else f"those of the first {1e3 * seen:g} mm"
    return [
        description(scenario.description),
        f"{needle_words(scenario.hand)} is fed {1e3 * scenario.depth:g} mm deep into "
        f"{scenario.phantom} at {1e3 * scenario.feed.speed:g} mm/s. {bevel}",
        f"The probe {scenario.probe} steps along and takes a slice every "
        f"{1e3 * scenario.step:g} mm; the estimator {scenario.estimator} uses {used}.",
    ]
