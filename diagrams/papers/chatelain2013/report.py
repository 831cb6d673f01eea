"""Report of the reproduction of Chatelain 2013: rows beside the paper's figures and the targets."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sonoservo.diagrams.papers.chatelain2013.plots import study_figures
from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, Run, quantile
from sonoservo.diagrams.studies.following.method_report import (
    ERRORS,
    Comparison,
    MethodRuns,
    Quantity,
    at_rest,
    converged,
    errors,
    false_starts,
    reliability,
    summed,
)
from sonoservo.diagrams.studies.run_group import Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, read_notes
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

TITLE = (
    "Chatelain, Krupa and Marchal, Real-time needle detection and tracking using a visually "
    "servoed 3D ultrasound probe (ICRA 2013)"
)


_MM, _DEG = 1e3, float(np.rad2deg(1))

_ABLATION = "fig5, "
"""Beginning of the name of an experiment with one part of our method switched off."""


def report(outcomes: Sequence[Outcome], folder: Path | None = None) -> Study:
    """Return the study of finished runs; without its folder, there are no figures."""
    logs = folder and folder / "logs"
    names = dict.fromkeys(each.case.experiment.removesuffix(AS_PUBLISHED) for each in outcomes)
    ablations = [each.removeprefix(_ABLATION) for each in names if each.startswith(_ABLATION)]
    groups = {name: Comparison(outcomes, name, logs) for name in names}
    rows = [row for group in groups.values() for row in group.rows(_quantities(group, groups))]
    runs = {name: group.ours.runs for name, group in groups.items()}
    runs |= {name + AS_PUBLISHED: group.published.runs for name, group in groups.items()}
    return Study(
        paper="chatelain2013",
        title=TITLE,
        rows=rows,
        outcomes=outcomes,
        figures=study_figures(runs, ablations) if logs else (),
        compute_ms=_compute_ms(runs["fig4"]) if "fig4" in groups else {},
        notes=read_notes("sonoservo.diagrams.papers.chatelain2013"),
    )


def _found(method: MethodRuns, insertion: int, where: int, q: float) -> Value:
    """Return a quantile of the lengths in the image (0) or in the tissue (1) when it was found."""
    found = [run.found for run in method.runs]
    lengths = [_MM * each[insertion][where] for each in found if len(each) > insertion]
    return pooled([np.array([each]) for each in [*lengths, *method.failed * [np.inf]]],
                  quantile_of(q))  # fmt: skip


def _worst(key: str) -> Callable[[MethodRuns], Value]:
    """Return the largest of a figure of the force over all runs."""
    return lambda method: method.largest(lambda run: run.figure("force", key))


def _lag(method: MethodRuns) -> Value:
    return method.mean(lambda run: _MM * run.lag)


def _lag_ratio(group: Comparison, eq_25: Comparison) -> Quantity:
    """Return by how much less our method lags with feed-forward."""
    without, ours = _lag(eq_25.ours).true, _lag(group.ours).true
    ratio = without / ours if without and ours else None
    return Quantity(
        "lag without feed-forward over that", "",
        lambda method: Value(ratio if method is group.ours else None),
        target=4, wanted="at least",
    )  # fmt: skip


def _over_moves(figure: Callable[[Any], float]) -> Callable[[MethodRuns], Value]:
    """Return a figure of the times of recovery after all moves; infinite in a failed run."""

    def of(method: MethodRuns) -> Value:
        runs = [np.array(run.recovery_times) for run in method.runs]
        moves = max(map(len, runs), default=0)
        runs += method.failed * [np.full(moves, np.inf)]
        return pooled([each for each in runs if len(each)], figure)

    return of


def _share_of_period(run: Run) -> float:
    """Return the 99 % quantile of the tracker's time over the duration of a sweep, in %."""
    scenario = run.scenario
    period = sweep_geometry(load_transducer(scenario.probe), scenario.imaging).period
    return 100 * float(np.quantile(run.volumes.track_time, 0.99)) / period


_CONVERGED = Quantity("runs that converged", "%", converged())
_BACK = Quantity("back after a move, all moves of all runs", "%",
                 _over_moves(lambda times: 100 * float(np.isfinite(times).mean())))  # fmt: skip
_TIP = errors("tip", "tip error", "mm", _MM)
_FORCE = (
    summed("contact force, mean", "N", "force", "mean_n", paper=2.0),
    Quantity("contact force, RMS error, worst run", "N", _worst("rms_error_n")),
)

_FIG4 = (
    *(Quantity(f"tracking a volume, {what}", "ms",
               partial(MethodRuns.error, name="track_time", q=q, factor=_MM), 175, target)
      for what, q, target in (("median", 0.5, 10), ("99 %", 0.99, 175))),
    *(Quantity(f"in the {where} when found within 10 mm, {which} insertion, {what}", "mm",
               partial(_found, insertion=k, where=i, q=q),
               target=15 if (where, what) == ("image", "largest") else None)
      for k, which in enumerate(("first", "second"))
      for what, q in (("median", 0.5), ("largest", 1.0))
      for i, where in enumerate(("image", "tissue"))),
    *errors("tip", "tip error", "mm", _MM, median=0.7, p95=1.5),
    *errors("axis", "axis error", "deg", _DEG, median=0.7, p95=1.5),
    *reliability(target=0),
)  # fmt: skip

_FIG5 = (
    *at_rest(((1.10, 0.6), (0.23, 0.2), (0.97, 0.6)), share=100),
    Quantity("lag in X while the hand moves at 5 mm/s", "mm", _lag),
)

_FIG6 = (
    _BACK,
    Quantity("runs back after every move", "%",
             lambda m: m.share(lambda run: bool(np.isfinite(run.recovery_times).all())),
             target=96, wanted="at least"),
    *(Quantity(f"from the end of a move until back, {what}", "s", _over_moves(quantile_of(q)),
               target=target)
      for what, q, target in (("median", 0.5, 3.0), ("95 %", 0.95, None))),
    Quantity("contact lost, worst run", "s", _worst("contact_lost_s"), target=0.5),
    Quantity("force, largest", "N", _worst("max_n"), target=6),
    *_FORCE, *ERRORS, *reliability(),
)  # fmt: skip

_QUANTITIES: Mapping[str, Iterable[Quantity]] = {
    "fig4": _FIG4,
    "fig6": _FIG6,
    "bent": (
        *errors("curve", "largest deviation along the curve", "mm", _MM, median=0.8, p95=1.5),
        *_TIP,
        Quantity("runs with the tip centred", "%", converged(straight=False)),
        *reliability(),
    ),
    "directions": (*ERRORS, _CONVERGED, *reliability()),
    "settings": (
        *ERRORS,
        *reliability(),
        Quantity("tracking a volume, 99 %, over the period of the acquisition", "%",
                 lambda method: method.mean(_share_of_period), target=100),
    ),
    "no needle": (
        Quantity("volumes", "",
                 lambda m: Value(sum(len(run.volumes.tip) for run in m.runs))),
        false_starts(target=0),
    ),
    "open": (_CONVERGED, *_TIP[:2]),
    **dict.fromkeys(("open, alpha_0", "open, margin"), (_BACK, *_TIP[:2])),
    "fig5, ": [each for each in (*ERRORS, *reliability()) if "largest" not in each.name],
}  # fmt: skip
"""Quantities of an experiment, by the beginning of its name; the longest one counts."""


def _quantities(group: Comparison, groups: Mapping[str, Comparison]) -> Iterable[Quantity]:
    if group.name == "fig5":
        eq_25 = groups.get("fig5, no feed-forward")
        ratio = [_lag_ratio(group, eq_25)] if eq_25 else []
        force = (_FORCE[0], replace(_FORCE[1], target=0.05))
        return (*_FIG5, *ratio, *force, *ERRORS, *reliability())
    known = [each for each in _QUANTITIES if group.name.startswith(each)]
    return _QUANTITIES[max(known, key=len)] if known else ()


def _compute_ms(runs: Sequence[Run]) -> dict[str, dict[str, float | None]]:
    """Return the median and largest times of rendering, conversion and tracking, in ms."""
    columns: dict[str, list[Any]] = {}
    for run in runs:
        for name, times in run.compute.items():
            columns.setdefault(name, []).append(1e3 * times)
    return {
        name: {
            "median": quantile(np.concatenate(times), 0.5),
            "max": quantile(np.concatenate(times), 1.0),
        }
        for name, times in columns.items()
    }
