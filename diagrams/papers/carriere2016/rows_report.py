"""Rows of the reproduction of Carriere 2016: figures of each method, with their intervals."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.carriere2016.protocols import SETS, SWEEP_SEEDS
from sonoservo.diagrams.papers.carriere2016.runs import AS_PUBLISHED, TAUGHT
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import StudyRow, can_be_judged
from sonoservo.systems.evaluation.intervals import mean_interval, proportion_interval

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

_COVERED = {
    "particle_filter": "default wander",
    TAUGHT: "wander learnt from earlier needles",
    "least_squares": "least squares, constant curvature",
}


class _Set:
    """Runs of one experiment."""

    def __init__(self, name: str, outcomes: Sequence[Outcome]) -> None:
        self.name = name
        self.results = [each.result if each else {"methods": {}} for each in outcomes]

    def values(self, method: str, key: str, worst: bool = True) -> Floats:
        """Return a figure of every needle; without a prediction, the worst of the others."""
        figures = [result["methods"].get(method, {}) for result in self.results]
        values = np.array([each.get(key, np.nan) for each in figures], dtype=float)
        without = np.array(["tip_error_true_mm" not in each for each in figures], dtype=bool)
        if worst and np.isfinite(values).any():
            values[without] = np.nanmax(values)
        return values

    def has(self, method: str) -> bool:
        """Return True if any needle was run with a method."""
        return any(method in result["methods"] for result in self.results)

    def row(self, quantity: str, unit: str, **values: Any) -> StudyRow:
        return StudyRow(experiment=self.name, quantity=quantity, unit=unit, **values)

    def mean_row(
        self, quantity: str, unit: str, key: str, method: str = "particle_filter", **more: Any
    ) -> StudyRow:
        """Return the row of a mean error, against the truth and the measured path."""
        ours, published = (self._means(each, key) for each in (method, AS_PUBLISHED))
        return self.row(
            quantity, unit, **ours, **{f"published_{k}": v for k, v in published.items()}, **more
        )

    def _means(self, method: str, key: str) -> dict[str, float | None]:
        true = self.values(method, key.format("true"))
        low, high = mean_interval(true[np.isfinite(true)])
        return {
            "true": _mean(true),
            "estimated": _mean(self.values(method, key.format("measured"))),
            "low": low,
            "high": high,
        }

    def share_row(
        self, quantity: str, ours: Floats | None, published: Floats | None = None, **more: Any
    ) -> StudyRow:
        """Return the row of a share of needles in %, given 1, 0 or NaN for each.

        Its target is left out if so few needles can never meet it, or never miss it.
        """
        values: dict[str, Any] = {}
        known = 0 if ours is None else int(np.isfinite(ours).sum())
        if "target" in more and not can_be_judged(
            known, more["target"], more.get("wanted", "at most")
        ):
            del more["target"]
        for prefix, each in (("", ours), ("published_", published)):
            if each is not None and np.isfinite(each).any():
                judged = each[np.isfinite(each)]
                low, high = proportion_interval(int(judged.sum()), len(judged))
                values |= {
                    f"{prefix}true": 100 * float(judged.mean()),
                    f"{prefix}low": 100 * low,
                    f"{prefix}high": 100 * high,
                }
        return self.row(quantity, "%", **values, **more)


def set_rows(name: str, outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of one experiment; a failed run counts as a needle not followed."""
    runs, paper = _Set(name, outcomes), PAPER.get(name, {})
    published = _tracking(runs, AS_PUBLISHED)
    ours = _tracking(runs, "particle_filter")
    rows = [
        runs.row(
            "cross-section's error, median over needles", "mm",
            true=_median(ours["error"]), published_true=_median(published["error"]),
            **({"target": 0.2} if name in SETS else {}),
        )
    ]  # fmt: skip
    if name in SETS:
        rows += [
            runs.share_row("needles followed to the end", ours["to_the_end"],
                           published["to_the_end"], target=95.0, wanted="at least"),
            runs.share_row("measured tips that are missing", ours["missing"],
                           published["missing"]),
        ]  # fmt: skip
    rows += _error_rows(runs, paper)
    rows += _coverage_rows(runs)
    if name in SETS:
        rows += _time_rows(runs, paper)
    return rows


def sweep_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of the published method with other values of its parameters."""
    results = [each.result["sweeps"] for each in outcomes if each and each.result["sweeps"]]
    rows = []
    for name, values in results[0].items() if results else ():
        for value in values:
            for quantity, unit in (("tip", "mm"), ("shape", "mm2")):
                key = f"{quantity}_error_true_{unit}"
                errors = np.array([each[name][value][key] for each in results], dtype=float)
                errors[np.isnan(errors)] = np.nanmax(errors, initial=0.0)
                low, high = mean_interval(errors)
                rows.append(
                    StudyRow(
                        experiment=f"{outcomes[0].case.experiment}, first {SWEEP_SEEDS} needles",
                        quantity=f"{quantity} error, {name} = {value}, mean",
                        unit=unit.replace("2", "²"),
                        published_true=float(errors.mean()),
                        published_low=low,
                        published_high=high,
                    )
                )
    return rows


def _tracking(runs: _Set, method: str) -> dict[str, Floats]:
    """Return the median error in mm, and flags of every needle, of a method's tracker."""
    blocks = [each["methods"].get(method, {}).get("tracking", {}) for each in runs.results]
    error = [each.get("error_mm", {}).get("median") for each in blocks]
    return {
        "error": np.array([np.nan if each is None else each for each in error]),
        "to_the_end": np.array([float(each.get("to_the_end", False)) for each in blocks]),
        "missing": np.array([1.0 - float(each.get("tip_found", False)) for each in blocks]),
    }


def _error_rows(runs: _Set, paper: dict[str, float]) -> list[StudyRow]:
    rows = []
    for quantity, unit in (("tip", "mm"), ("shape", "mm²")):
        key = f"{quantity}_error_{{}}_{unit.replace('²', '2')}"
        rows.append(
            runs.mean_row(
                f"{quantity} error, mean",
                unit,
                key,
                paper=paper.get(quantity),
                target=paper.get(quantity),
            )
        )
        spread = {
            f"{prefix}{side}": _std(runs.values(method, key.format(against)))
            for prefix, method in (("", "particle_filter"), ("published_", AS_PUBLISHED))
            for side, against in (("true", "true"), ("estimated", "measured"))
        }
        rows.append(
            runs.row(f"{quantity} error, standard deviation", unit,
                     paper=paper.get(f"{quantity}_std"), **spread)
        )  # fmt: skip
        for method, label in _COVERED.items():
            if method != "particle_filter" and runs.has(method):
                means = runs._means(method, key)
                rows.append(runs.row(f"{quantity} error, {label}, mean", unit, **means))
    rows.append(
        runs.mean_row(
            "largest distance from the shape, in and out of the plane, mean", "mm",
            "max_error_{}_mm",
        )
    )  # fmt: skip
    least = np.array([each.get("bound", {}).get("tip_mm", np.nan) for each in runs.results])
    rows.append(
        runs.row(
            "tip error, root mean square", "mm",
            true=_rms(runs.values("particle_filter", "tip_error_true_mm")),
            published_true=_rms(runs.values(AS_PUBLISHED, "tip_error_true_mm")),
        )
    )  # fmt: skip
    rows.append(runs.row("tip error, bound of the root mean square", "mm", true=_rms(least)))
    return rows


def _coverage_rows(runs: _Set) -> list[StudyRow]:
    """Return the shares of needles whose tip, or shape, is within what is stated."""
    rows = []
    for key in ("tip", "shape"):
        published = runs.values(AS_PUBLISHED, f"covers_{key}", worst=False)
        for method, label in _COVERED.items():
            if not runs.has(method):
                continue
            covered = runs.values(method, f"covers_{key}", worst=False)
            quantity = f"{key} within its 95 %, {label}"
            both = published if method == "particle_filter" else None
            judged = key == "tip" and method == (TAUGHT if runs.has(TAUGHT) else "particle_filter")
            if not judged:
                rows.append(runs.share_row(quantity, covered, both))
                continue
            rows.append(runs.share_row(quantity, covered, both, target=90.0, wanted="at least"))
            rows.append(runs.share_row(f"{quantity}, not too wide", covered, both, target=99.0))
    return rows


def _time_rows(runs: _Set, paper: dict[str, float]) -> list[StudyRow]:
    compute = [each["compute_ms"] for each in runs.results if "compute_ms" in each]
    rows = []
    for part, label in (("image", "finding the cross-section"), ("estimate", "particle filter"),
                        ("total", "both")):  # fmt: skip
        median = _median(np.array([each[part]["median"] for each in compute], dtype=float))
        target = {"target": 2.0} if part == "total" else {}
        rows.append(runs.row(f"{label}, median", "ms", paper=paper[part], estimated=median,
                             **target))  # fmt: skip
    worst = max((each["total"]["max"] for each in compute), default=None)
    rows.append(runs.row("both, worst", "ms", paper=_PEAK, estimated=worst, target=_PEAK))
    return rows


def _mean(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else None


def _median(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _std(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.std(ddof=1)) if len(known) > 1 else None


def _rms(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None
