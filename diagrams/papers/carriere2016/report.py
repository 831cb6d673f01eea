"""Report of the reproduction of Carriere 2016: rows with targets, and figures."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.carriere2016.plots import (
    plot_departures,
    plot_error_against_depth,
    plot_errors,
    plot_particles,
    plot_paths,
    plot_slice,
    plot_sweeps,
)
from sonoservo.diagrams.papers.carriere2016.protocols import PROTOCOLS, SETS, SWEEP_SEEDS
from sonoservo.diagrams.papers.carriere2016.runs import AS_PUBLISHED, BEVEL_MARK_DEG, EXACT, TAUGHT
from sonoservo.diagrams.studies.run_group import Value
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyFigure, StudyRow, read_notes
from sonoservo.systems.evaluation.intervals import proportion_interval, run_interval

NAMES = {
    TAUGHT: "particle filter, wander learnt",
    "particle_filter": "particle filter",
    "least_squares": "least squares, constant curvature",
    AS_PUBLISHED: "as published",
}


def report(outcomes: Sequence[Outcome], folder: Path | None = None) -> Study:
    """Return the study of finished runs; without its folder, there are no figures."""
    rows = [
        row for name in PROTOCOLS if (mine := _of(outcomes, name)) for row in set_rows(name, mine)
    ]
    return Study(
        paper="carriere2016",
        title="Carriere, Rossa, Sloboda, Usmani, Tavakoli: Real-time needle shape prediction in "
        "soft-tissue based on image segmentation and particle filtering (AIM 2016)",
        rows=[*rows, *(row for name in SETS for row in sweep_rows(_of(outcomes, name)))],
        outcomes=outcomes,
        figures=_figures(outcomes) if folder else (),
        compute_ms=_compute(outcomes),
        notes=read_notes("sonoservo.diagrams.papers.carriere2016", bevel_mark_deg=BEVEL_MARK_DEG),
    )


def _compute(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float | None]]:
    """Return the largest median and the largest of all computing times of a needle."""
    times = [each.result["compute_ms"] for each in outcomes if each]
    return {
        part: {
            "median": max((each[part]["median"] or 0.0 for each in times), default=None),
            "max": max((each[part]["max"] or 0.0 for each in times), default=None),
        }
        for part in ("image", "estimate", "total")
    }


def _figures(outcomes: Sequence[Outcome]) -> list[StudyFigure]:
    every = {name: [each.result for each in _of(outcomes, name) if each] for name in PROTOCOLS}
    every = {name: each for name, each in every.items() if each}
    results = {name: each for name, each in every.items() if name in SETS}
    if not results:
        return []
    figures = [
        StudyFigure(
            name="paths",
            caption="Like figs. 8 and 9 of the paper: six needles of each set, measured and "
            "predicted path (particle filter). Dashed: last slice used.",
            figure=plot_paths(results),
        ),
        StudyFigure(
            name="error_against_depth",
            caption="Like fig. 7: error of the predicted tip against the depth observed; median "
            "and 90 % range of the needles, and median of the estimates' 95 % bounds.",
            figure=plot_error_against_depth(results, NAMES),
        ),
        StudyFigure(
            name="errors",
            caption="Tip and shape error against the true path, of all needles of each set.",
            figure=plot_errors(results, NAMES, PAPER),
        ),
        StudyFigure(
            name="departures",
            caption="Departures from the model: mean error of the predicted tip against the true "
            "one, and share of the tips within the stated 95 %, with 95 % intervals.",
            figure=plot_departures(every, NAMES),
        ),
    ]
    for name, needles in results.items():
        if swept := [each for each in needles if each["sweeps"]]:
            figures.append(
                StudyFigure(
                    name=f"sweeps_{name}",
                    caption=f"Published method on {name} with other values of the parameters that "
                    "the paper does not give, and of n: true errors, mean and 95 % interval.",
                    figure=plot_sweeps(swept),
                )
            )
    return figures + _kept_figures(results)


def _kept_figures(results: dict[str, list[Any]]) -> list[StudyFigure]:
    kept = {name: each[0] for name, each in results.items() if "slice" in each[0]}
    figures = [
        StudyFigure(
            name=f"slice_{name}",
            caption=f"Like figs. 2 and 3, {name}: first slice, and its variance image (eq. 1) with "
            "the template.",
            figure=plot_slice(result["slice"]),
        )
        for name, result in kept.items()
    ]
    for result in list(kept.values())[:1]:
        figures.append(
            StudyFigure(
                name="particles",
                caption="Like fig. 6: particles of one needle before the first slice, five slices "
                "after 10 mm, and at the end. The cross is the truth; the faint cross is the path "
                "that starts alike and bends to the other side.",
                figure=plot_particles(
                    result["particles"], result["truth"], {**NAMES, "published": "as printed"}
                ),
            )
        )
    return figures


def _of(outcomes: Sequence[Outcome], experiment: str) -> list[Outcome]:
    return [each for each in outcomes if each.case.experiment == experiment]


Floats = NDArray[np.float64]

PAPER: dict[str, dict[str, float]] = {  # Tables I and II
    "d60": {"tip": 0.497, "tip_std": 0.38, "shape": 105.0, "shape_std": 15.1,
            "image": 3.1, "estimate": 2.8, "total": 5.9},
    "d80": {"tip": 0.125, "tip_std": 0.02, "shape": 18.4, "shape_std": 5.0,
            "image": 3.1, "estimate": 2.6, "total": 5.7},
    "patient": {"tip": 0.44, "tip_std": 0.15, "shape": 19.1, "shape_std": 9.6,
                "image": 4.1, "estimate": 2.4, "total": 6.5},
}  # fmt: skip

_PEAK = 9.5
"""Longest computing time of a slice in ms, section V."""

OURS, LEAST_SQUARES = "particle_filter", "least_squares"

_STATED = {
    OURS: "default wander",
    TAUGHT: "wander learnt from earlier needles",
    LEAST_SQUARES: "least squares, constant curvature",
}
"""What the error that a method states rests on."""

_PARTS = {"image": "finding the cross-section", "estimate": "particle filter", "total": "both"}

_ABLATED = {"published": "our cross-sections", EXACT: "exact cross-sections"}
"""Input of the printed filter without the printed search for cross-sections."""


class _Needles:
    """Needles of one experiment, and rows made of them; a failed run is a needle not followed."""

    def __init__(self, name: str, outcomes: Sequence[Outcome]) -> None:
        self.name = name
        self.results = [each.result if each else {"methods": {}} for each in outcomes]
        self.rows: list[StudyRow] = []

    def row(
        self, quantity: str, unit: str, ours: Value, published: Value | None = None, **more: Any
    ) -> None:
        """Add a row with a figure of our method, or of the published one, or of both."""
        self.rows.append(StudyRow.of(self.name, quantity, unit, ours, published, **more))

    def has(self, method: str) -> bool:
        """Return True if any needle was run with a method."""
        return any(method in result["methods"] for result in self.results)

    def column(self, method: str, key: str, worst: bool = True) -> Floats:
        """Return a figure of every needle; without a prediction, the worst of the others."""
        figures = [result["methods"].get(method, {}) for result in self.results]
        values = np.array([each.get(key, np.nan) for each in figures], dtype=float)
        without = np.array(["tip_error_true_mm" not in each for each in figures], dtype=bool)
        if worst and np.isfinite(values).any():
            values[without] = np.nanmax(values)
        return values

    def mean(self, method: str, key: str) -> Value:
        """Return the mean of an error, against the truth and the measured path."""
        true, measured = (self.column(method, key.format(each)) for each in ("true", "measured"))
        interval = run_interval(true[np.isfinite(true)])
        return Value(_figure(np.mean, true), _figure(np.mean, measured), *interval)

    def std(self, method: str, key: str) -> Value:
        """Return the standard deviation of an error, against the truth and the measured path."""
        columns = (self.column(method, key.format(each)) for each in ("true", "measured"))
        true, measured = (_figure(partial(np.std, ddof=1), each, least=2) for each in columns)
        return Value(true, measured)

    def tracking(self, method: str, *path: str, missing: Any = None) -> Floats:
        """Return a figure of every needle of a method's tracker."""
        values = []
        for result in self.results:
            node = result["methods"].get(method, {}).get("tracking", {})
            for key in path:
                node = (node or {}).get(key)
            values.append(missing if node is None else node)
        return np.array(values, dtype=float)

    def compute(self, part: str, which: str) -> Floats:
        """Return a computing time of every needle that was run, in ms."""
        times = [each["compute_ms"] for each in self.results if "compute_ms" in each]
        return np.array([each[part][which] for each in times], dtype=float)


def _figure(statistic: Callable[[Floats], Any], values: Floats, least: int = 1) -> float | None:
    """Return a statistic of the finite values; None of fewer than some."""
    known = values[np.isfinite(values)]
    return float(statistic(known)) if len(known) >= least else None


def _share(flags: Floats) -> Value:
    """Return the share in % of needles, given 1, 0 or NaN for each."""
    judged = flags[np.isfinite(flags)]
    if not len(judged):
        return Value()
    low, high = proportion_interval(int(judged.sum()), len(judged))
    share = 100 * float(judged.mean())
    return Value(share, None, 100 * low, 100 * high, len(judged))


def set_rows(name: str, outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of one experiment; a failed run counts as a needle not followed."""
    needles, paper, printed = _Needles(name, outcomes), PAPER.get(name, {}), name in SETS

    def both(quantity: str, unit: str, figure: Callable[[str], Value], **more: Any) -> None:
        needles.row(quantity, unit, figure(OURS), figure(AS_PUBLISHED), **more)

    def middle(method: str) -> Value:
        return Value(_figure(np.median, needles.tracking(method, "error_mm", "median")))

    both("cross-section's error, median over needles", "mm", middle,
         target=0.2 if printed else None)  # fmt: skip
    if printed:
        both("needles followed to the end", "%",
             lambda m: _share(needles.tracking(m, "to_the_end", missing=0)),
             target=95.0, wanted="at least")  # fmt: skip
        both("measured tips that are missing", "%",
             lambda m: _share(1 - needles.tracking(m, "tip_found", missing=0)))  # fmt: skip
    for quantity, unit in (("tip", "mm"), ("shape", "mm²")):
        key = f"{quantity}_error_{{}}_{unit.replace('²', '2')}"
        known = paper.get(quantity)
        both(f"{quantity} error, mean", unit, partial(needles.mean, key=key),
             paper=known, target=known)  # fmt: skip
        both(f"{quantity} error, standard deviation", unit, partial(needles.std, key=key),
             paper=paper.get(f"{quantity}_std"))  # fmt: skip
        for method in (each for each in (TAUGHT, LEAST_SQUARES) if needles.has(each)):
            needles.row(f"{quantity} error, {_STATED[method]}, mean", unit,
                        needles.mean(method, key))  # fmt: skip
    both("largest distance from the shape, in and out of the plane, mean", "mm",
         lambda m: needles.mean(m, "max_error_{}_mm"))  # fmt: skip
    for method, label in _ABLATED.items():
        needles.row(f"tip error, filter as printed, {label}, mean", "mm", Value(),
                    needles.mean(method, "tip_error_{}_mm"))  # fmt: skip
    both("tip error, root mean square", "mm",
         lambda m: Value(_figure(_rms, needles.column(m, "tip_error_true_mm"))))  # fmt: skip
    least = np.array([each.get("bound", {}).get("tip_mm") for each in needles.results], float)
    needles.row("tip error, bound of the root mean square", "mm", Value(_figure(_rms, least)))
    judged = TAUGHT if needles.has(TAUGHT) else OURS
    for key in ("tip", "shape"):
        for method in (each for each in _STATED if needles.has(each)):
            shares = [_share(needles.column(each, f"covers_{key}", worst=False))
                      for each in (method, AS_PUBLISHED)]  # fmt: skip
            stated = f"{key} within its 95 %, {_STATED[method]}"
            if (key, method) != ("tip", judged):
                needles.row(stated, "%", shares[0], shares[1] if method == OURS else None)
                continue
            shares = shares if method == OURS else shares[:1]
            needles.row(stated, "%", *shares, target=90.0, wanted="at least")
            needles.row(f"{stated}, not too wide", "%", shares[0], target=99.0)
    if printed:
        for part, label in _PARTS.items():
            median = Value(None, _figure(np.median, needles.compute(part, "median")))
            needles.row(f"{label}, median", "ms", median, paper=paper[part],
                        target=2.0 if part == "total" else None)  # fmt: skip
        worst = Value(None, _figure(np.max, needles.compute("total", "max")))
        needles.row("both, worst", "ms", worst, paper=_PEAK, target=_PEAK)
    return needles.rows


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def sweep_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of the published method with other values of its parameters."""
    results = [each.result["sweeps"] for each in outcomes if each and each.result["sweeps"]]
    rows = []
    for name, values in results[0].items() if results else ():
        for value in values:
            for quantity, unit in (("tip", "mm"), ("shape", "mm2")):
                true, measured = (
                    np.array([each[name][value][f"{quantity}_error_{against}_{unit}"]
                              for each in results], dtype=float)
                    for against in ("true", "measured")
                )  # fmt: skip
                true[np.isnan(true)] = np.nanmax(true, initial=0.0)
                rows.append(
                    StudyRow.of(
                        f"{outcomes[0].case.experiment}, first {SWEEP_SEEDS} needles",
                        f"{quantity} error, {name} = {value}, mean",
                        unit.replace("2", "²"),
                        Value(),
                        Value(float(true.mean()), _figure(np.mean, measured), *run_interval(true)),
                    )
                )
    return rows
