"""Analysis of finished runs of following from their logs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.diagrams.studies.study import Case, Outcome, WithFiles
from sonoservo.systems.evaluation.log import encode_log, read_log
from sonoservo.systems.evaluation.metrics import at_rest
from sonoservo.systems.evaluation.run_errors import (
    at_times,
    curve_deviations,
    estimate_errors,
    features,
    in_frame,
)
from sonoservo.systems.evaluation.run_log import RunLog, unit
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

Floats = NDArray[np.float64]

ENOUGH_IN_VIEW = 20e-3  # length of needle in the image from which on errors count, in m

_NOT_TO_BE_LOST = 15e-3
"""Length in the image above which a needle counts as lost while the tracker searches, in m."""

_OUT_OF_VIEW = 2e-3  # length in the image below which one insertion ends and the next begins, in m

_RIGHT_PLACE = 10e-3
"""Distance from the estimated to the true tip within which a needle counts as found, in m."""

_CENTRED = np.array([2e-3, 2e-3, np.deg2rad(2)])
"""Errors of X, Z and Theta below which the needle is centred again, in m and rad."""

_STAYS = 0.5  # time in s for which it must stay centred
_LAG_TIME = 2.0  # time in s before the end of a push over which the fully developed lag is measured


class Run:
    """One finished run of following, as its record keeps it (`describe_run`); plots need a log."""

    def __init__(self, outcome: Outcome, logs: Path | None = None) -> None:
        self.outcome, self._logs = outcome, logs

    @property
    def log(self) -> RunLog:
        """Log of the run, read each time, because the logs of a study do not fit in memory."""
        assert self._logs is not None
        return read_log(self._logs / f"{self.outcome.case.name}.npz", RunLog)

    @property
    def summary(self) -> Mapping[str, Any]:
        """Figures of the run, as in summary.json."""
        return cast(Mapping[str, Any], self.outcome.result["summary"])

    def figure(self, *path: str) -> float | None:
        """Return a figure of the summary by its path."""
        node: Any = self.summary
        for key in path:
            node = node[key]
        return None if node is None else float(node)

    @cached_property
    def scenario(self) -> FollowingScenario:
        """Scenario of the run."""
        return load_case(self.outcome.case)

    @property
    def rest(self) -> tuple[Floats, Floats]:
        """True and estimated mean errors at rest; see `rest_errors`."""
        true, estimated = (_array(each, np.nan) for each in self.outcome.result["rest"])
        return true, estimated

    @property
    def found(self) -> list[tuple[float, float]]:
        """Lengths when the needle was found; see `found_after`."""
        pairs = [_array(each, np.inf) for each in self.outcome.result["found"]]
        return [(float(visible), float(inserted)) for visible, inserted in pairs]

    @property
    def recovery_times(self) -> list[float]:
        """Times of recovery after each move of the phantom; see `recovery_times`."""
        return [float(each) for each in _array(self.outcome.result["recovery_times"], np.inf)]

    def converged(self, straight: bool = True) -> bool:
        """Return True if the needle was centred throughout the last second; see `centred`."""
        return bool(self.outcome.result["converged"]["straight" if straight else "bent"])

    @property
    def lag(self) -> float:
        """Lag in m while the needle moves; see `lag`."""
        return float(_array(self.outcome.result["lag"], np.nan))

    @property
    def compute(self) -> Mapping[str, Floats]:
        """Computing times of the volumes in s, by stage."""
        return {name: np.array(each) for name, each in self.outcome.result["compute"].items()}

    @cached_property
    def volumes(self) -> "Volumes":
        """Errors and features by volume."""
        kept = self.outcome.result["volumes"]
        arrays: dict[str, Any] = {
            name: np.array(each, dtype=bool)
            if name in _MASKS
            else _array(each, np.inf if name in _ERRORS else np.nan)
            for name, each in kept.items()
        }
        return Volumes(**arrays)


def load_case(case: Case) -> FollowingScenario:
    """Return the scenario of a case, with the published method if the case asks for it."""
    settings = case.settings
    loaded = load_scenario(
        settings["scenario"],
        seed=case.seed,
        changes=list(settings["changes"]),
        as_published=bool(settings.get("as_published", False)),
    )
    return require_scenario(loaded, FollowingScenario)


_MASKS, _ERRORS = ("enough", "tracked", "lost"), ("tip", "axis", "curve")


def _array(kept: Any, missing: float) -> Floats:
    """Return kept numbers as an array; JSON has no infinite numbers, so they are missing."""
    array = np.array(kept, dtype=float)
    return np.where(np.isfinite(array), array, missing)


def describe_run(
    log: RunLog, scenario: FollowingScenario, geometry: SweepGeometry
) -> dict[str, Any]:
    """Return what a study keeps of a run beside its summary; see `Run`."""
    found = volumes(log, curve_deviations(log, geometry))
    return {
        "rest": rest_errors(log),
        "found": found_after(log),
        "recovery_times": recovery_times(log, scenario),
        "converged": {"straight": converged(log), "bent": converged(log, straight=False)},
        "lag": lag(log, scenario),
        "compute": dict(log.compute),
        "volumes": {each.name: getattr(found, each.name) for each in fields(Volumes)},
    }


@dataclass(frozen=True, eq=False)
class Volumes:
    """Data of a run for each of its v volumes; errors are infinite without an estimate."""

    enough: NDArray[np.bool_]  # (v,) at least `ENOUGH_IN_VIEW` of the needle in the image
    tracked: NDArray[np.bool_]  # (v,) volumes that confirmed the needle
    lost: NDArray[np.bool_]  # (v,) searching again for one well in the image; not coasting
    tip: Floats  # (v,) in m
    axis: Floats  # (v,) in rad
    curve: Floats  # (v,) largest deviation along it, in m
    true: Floats  # (v, 3) features X, Z in m, Theta in rad
    estimated: Floats
    p_PTip: Floats  # (v, 3) in P, in m
    p_PTip_estimated: Floats
    track_time: Floats  # (v,) computing time of the tracker, in s
    time: Floats  # (v,) for which the estimates hold, or else of the volumes, in s
    along: Floats  # (v,) estimated speed along the true needle, in m/s


def volumes(log: RunLog, curve_deviation: Floats) -> Volumes:
    """Return a log's data for each volume, at the time for which the estimate holds."""
    dated = np.isfinite(log.volume_estimate_time)
    time = np.where(dated, log.volume_estimate_time, log.volume_time)
    visible = np.nan_to_num(at_times(log, log.visible_length, time))
    X_WP, measured = (at_times(log, each, time) for each in (log.X_WP, log.measured_X_WP))
    tip, entry = (at_times(log, each, time) for each in (log.needle_tip, log.needle_entry))
    errors = estimate_errors(log)
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    coasting = log.volume_estimate_mode == TrackingMode.COASTING
    found = np.cumsum(tracked) > 0

    return Volumes(
        enough=visible >= ENOUGH_IN_VIEW,
        tracked=tracked,
        lost=found & ~tracked & ~coasting & (visible >= _NOT_TO_BE_LOST),
        tip=_or_infinite(errors.tip),
        axis=_or_infinite(errors.axis),
        curve=_or_infinite(curve_deviation),
        true=features(X_WP, tip, entry),
        estimated=features(measured, log.volume_estimate_tip, log.volume_estimate_entry),
        p_PTip=in_frame(X_WP, tip),
        p_PTip_estimated=in_frame(measured, log.volume_estimate_tip),
        track_time=np.asarray(log.compute["track"]),
        time=time,
        along=np.sum(log.volume_estimate_velocity * unit(tip - entry), axis=1),
    )


def _or_infinite(errors: Floats) -> Floats:
    return np.where(np.isfinite(errors), errors, np.inf)


def pooled(runs: Sequence[Run], failed: int, values: Callable[[Volumes], Floats]) -> Floats:
    """Return the values of all volumes with enough of the needle in view, over all runs."""
    return np.concatenate([np.zeros(0), *pooled_runs(runs, failed, values)])


def pooled_runs(
    runs: Sequence[Run], failed: int, values: Callable[[Volumes], Floats]
) -> list[Floats]:
    """Return the values of each run's volumes with enough of the needle in view; see `pooled`."""
    each = [values(run.volumes)[run.volumes.enough] for run in runs]
    usual = int(np.median([len(one) for one in each])) if each else 0
    return [*each, *(failed * [np.full(usual, np.inf)])]


def quantile(values: Sequence[float] | Floats, q: float) -> float | None:
    """Return a quantile that is one of the values, which may be infinite; None without values."""
    if len(values) == 0:
        return None
    return float(np.quantile(np.asarray(values), q, method="inverted_cdf"))


def found_after(log: RunLog) -> list[tuple[float, float]]:
    """Return the lengths of needle in the image and in the tissue when it was found, in m."""
    time = log.volume_estimate_time
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    right = tracked & (estimate_errors(log).tip < _RIGHT_PLACE)
    inside = np.nan_to_num(log.visible_length) > _OUT_OF_VIEW
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    lengths = []
    for start, stop in edges.reshape(-1, 2):
        if log.visible_length[start:stop].max() < ENOUGH_IN_VIEW:
            continue
        during = (time >= log.time[start]) & (time <= log.time[stop - 1])
        first = np.flatnonzero(right & during)[:1]
        visible, inserted = (
            at_times(log, each, time[first]) for each in (log.visible_length, log.inserted_length)
        )
        lengths.append((float(visible[0]), float(inserted[0])) if len(first) else (np.inf, np.inf))
    return lengths


def rest_errors(log: RunLog) -> tuple[Floats, Floats]:
    """Return (3,) mean absolute features at rest in m and rad: true, and as estimated."""
    rest = at_rest(log)
    if not rest.any():
        return np.full(3, np.nan), np.full(3, np.nan)
    true = np.abs(features(log.X_WP, log.needle_tip, log.needle_entry))[rest]
    seen = np.abs(features(log.measured_X_WP, log.estimate_tip, log.estimate_entry))[rest]
    seen = np.where(np.isfinite(seen), seen, true)
    return true.mean(axis=0), seen.mean(axis=0)


def centred(log: RunLog, straight: bool = True) -> NDArray[np.bool_]:
    """Return an (n,) mask of samples with the needle tracked, centred and aligned, in truth.

    Of a bent needle only the tip counts: its true direction starts where the image does not show
    it.
    """
    true = np.abs(features(log.X_WP, log.needle_tip, log.needle_entry))
    tracked = log.estimate_mode == TrackingMode.TRACKING
    judged = slice(None if straight else 2)
    return np.asarray(tracked & (true < _CENTRED)[:, judged].all(axis=1))


def converged(log: RunLog, straight: bool = True) -> bool:
    """Return True if the needle was centred throughout the last second."""
    return bool(centred(log, straight)[log.time >= log.time[-1] - 1.0].all())


def recovery_times(log: RunLog, scenario: FollowingScenario) -> list[float]:
    """Return the times in s from each move's end until centred for `_STAYS`; infinite if never."""
    good = centred(log)
    moves = scenario.phantom_motion.moves
    times = []
    for move, following in zip(moves, [*moves[1:], None], strict=False):
        end = move.start + move.duration
        limit = min(following.start if following else np.inf, log.time[-1])
        if limit <= end + _STAYS:
            continue  # the run was over before
        after = np.flatnonzero((log.time >= end) & (log.time <= limit))
        count = round(_STAYS / (log.time[1] - log.time[0]))
        held = np.convolve(good[after], np.ones(count), mode="valid") == count
        times.append(float(log.time[after[np.argmax(held)]] - end) if held.any() else np.inf)
    return times


def lag(log: RunLog, scenario: FollowingScenario) -> float:
    """Return the mean |X| of the true tip at the end of the last push, in m; NaN if not reached."""
    hand = scenario.hand
    end = (hand.start or 0.0) + sum(push.duration for push in hand.pushes)
    during = (log.time >= end - _LAG_TIME) & (log.time <= end)
    if log.time[-1] < end:
        return float("nan")
    x = features(log.X_WP, log.needle_tip, log.needle_entry)[during, 0]
    return float(np.abs(x).mean())


AS_PUBLISHED = ", as published"  # ending of the name of an experiment with the published method


def run_case(case: Case) -> WithFiles:
    """Run a case's scenario; return summary and `describe_run`, and the log as a file."""
    experiment = FollowingExperiment(load_case(case))
    experiment.run()
    log, scenario = experiment.log(), experiment.scenario
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    result = {"summary": experiment.summarize(log), **describe_run(log, scenario, geometry)}
    return WithFiles(result, {f"{case.name}.npz": encode_log(log)})
