"""Base class of the presenters of an experiment's runs: words, plots and pictures."""

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.systems.evaluation.reports.verdict import Verdict
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER, InsertionParameters


class Presenter:
    """Presenter of an experiment's runs, which shows nothing itself; subclasses do."""

    labels: ClassVar[Mapping[str, str]] = {}
    overlay_caption: ClassVar[str] = ""

    def __init__(self, experiment: Experiment[Any]) -> None:
        self._experiment: Any = experiment

    @staticmethod
    def overlay(logs: Mapping[str, Any]) -> Figure:
        """Return the curves of several runs over one another, by name."""
        return Figure()

    def plots(self, log: Any) -> dict[str, tuple[str, Figure]]:
        """Return the plots of a log: caption and figure by file name."""
        return {}

    def verdict(self, summary: Mapping[str, Any]) -> Verdict | None:
        """Return the verdict on a run from its summary, if there is one."""
        return None

    def words(self) -> list[str]:
        """Return sentences that describe what was run."""
        return []

    def key_frames(self, log: Any) -> dict[str, Figure]:
        """Return pictures of a run's telling moments, by caption; none unless they were kept."""
        return {}

    def frames(self, log: Any) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames of a movie, (rows, columns, 3) each, one per volume or slice."""
        raise NotImplementedError

    @property
    def frame_rate(self) -> float:
        """Volumes or slices per second, and so frames per second of a movie."""
        raise NotImplementedError


def description(text: str) -> str:
    """Return a scenario's description as a sentence."""
    return f"{text.rstrip('.')}." if text else ""


def needle_words(hand: InsertionParameters) -> str:
    """Return a needle with its gauge, diameter and bend, as the subject of a sentence."""
    bend = hand.bend_radius
    kind = "straight" if bend is None else f"bending on a radius of {1e3 * bend:g} mm"
    return f"The needle ({hand.gauge} gauge, {1e3 * OUTER_DIAMETER[hand.gauge]:.2f} mm, {kind})"
