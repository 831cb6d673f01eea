"""The benchmark as a study: sequences as cases, their records, and the results."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from rich.console import Console

from sonoservo.diagrams.benchmark.entrants import (
    checked,
    resolve_entrant,
    sequence_name,
    start_tracker,
)
from sonoservo.diagrams.benchmark.estimates import Estimated, estimates_text, parse_estimates
from sonoservo.diagrams.benchmark.scores import judge_sequence, reliability, score
from sonoservo.diagrams.benchmark.sequence import (
    SEQUENCES,
    VERSION,
    acquire_sequence,
    load_suites,
    sequence_seeds,
)
from sonoservo.diagrams.benchmark.sequence import Sequence as Volumes
from sonoservo.diagrams.studies.fingerprint import code_fingerprint, made_with
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case, Executor, Outcome, WithFiles
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.track_plots import picture_planes, plot_planes
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode

KEPT_TRACKERS = (
    "chatelain2013",
    "brightest_line",
    "chatelain2013_as_published",
    "zhao2012_as_published",
)
"""Trackers whose scores are kept; the first two are scored by default."""

ALL = "all suites"  # name of the scores over all suites


@dataclass(frozen=True, kw_only=True)
class BenchmarkOptions:
    """Options of the benchmark; see `run_cases` for the last ones."""

    folder: Path
    suites: Sequence[str] = ()  # all of them if none is named
    quick: bool = False  # the first sequence of each suite only
    salt: int = 0  # draws other sequences; 0 for reporting
    sequences: int | None = None  # in a suite; by default, all of them
    jobs: int = -1
    cluster: Executor | None = None
    console: Console | None = None

    def cases(self, **settings: Any) -> list[Case]:
        """Return a case for each sequence, with further settings."""
        count = self.sequences or (1 if self.quick else SEQUENCES)
        try:
            seeds = sequence_seeds(self.salt, count)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error
        return [
            Case(name, seed, {**suite.settings(), **settings})
            for name, suite in load_suites(self.suites).items()
            for seed in seeds
        ]


@dataclass(frozen=True)
class BenchmarkResult:
    """Results of the benchmark: contents of benchmark.json, and outcomes of all sequences."""

    data: dict[str, Any]
    outcomes: list[Outcome] = field(repr=False)

    @property
    def failed(self) -> list[Outcome]:
        """Sequences in which a tracker, or the simulation, raised an error."""
        return [each for each in self.outcomes if not each]


def run_benchmark(trackers: Sequence[str], options: BenchmarkOptions) -> BenchmarkResult:
    """Score trackers (`resolve_entrant`) on the same volumes; a second call goes on."""
    plain = options.cases()
    names = [sequence_name(case.experiment, case.seed) for case in plain]
    entrants = [resolve_entrant(each, dict.fromkeys(names)) for each in trackers]
    called = [each["name"] for each in entrants]
    if len(set(called)) < len(called):
        raise ConfigurationError(f"two trackers have the same name: {', '.join(called)}")
    cases = []
    for name, case in zip(names, plain, strict=True):
        own = [
            {**each, "tables": {name: each["tables"][name]}} if "tables" in each else each
            for each in entrants
        ]
        cases.append(Case(case.experiment, case.seed, {**case.settings, "entrants": own}))
    outcomes = run_cases(
        run_sequence, cases, options.folder / "cases",
        jobs=options.jobs, cluster=options.cluster, console=options.console,
    )  # fmt: skip
    return BenchmarkResult(summarize(outcomes, salt=options.salt, quick=options.quick), outcomes)


def run_sequence(case: Case) -> WithFiles:
    """Make a sequence, let every tracker see it, and return their records and worst pictures."""
    sequence = acquire_sequence(case.settings, case.seed)
    name = sequence_name(case.experiment, case.seed)
    volumes = [(each.time, each.X_WP) for each in sequence.volumes]
    records, files = {}, {}
    for entrant in case.settings["entrants"]:
        if "tables" in entrant:
            rows = parse_estimates(entrant["tables"][name], name)
        else:
            rows = _track(entrant, sequence)
            files[f"{entrant['name']}/{name}.csv"] = estimates_text(rows).encode()
        record = judge_sequence(sequence.truth, volumes, sequence.lifted, rows)
        records[entrant["name"]] = record
        files[f"{entrant['name']}/{name}.png"] = _picture(sequence, rows, record["worst"])
    return WithFiles(records, files)


def _track(entrant: Mapping[str, Any], sequence: Volumes) -> list[Estimated]:
    step = start_tracker(entrant, sequence.tracker_seed)
    rows = []
    for number, volume in enumerate(sequence.volumes):
        began = time.process_time()
        estimate = checked(step, volume, entrant["name"])
        rows.append(Estimated.of(number, volume, estimate, 1e3 * (time.process_time() - began)))
    return rows


def _picture(sequence: Volumes, rows: Sequence[Estimated], number: int) -> bytes:
    """Return a picture of a volume along the true needle, and along the estimated one."""
    volume = sequence.volumes[min(number, len(sequence.volumes) - 1)]
    row = next((each for each in rows if each.volume == number), None)
    estimated = None
    if row:
        estimated = NeedleCurve(volume.X_WP.multiply(np.stack([row.entry, row.tip], axis=1)).T)
    log = sequence.truth
    nearest = int(abs(log.time - volume.time).argmin())
    points = log.needle_points[nearest]
    true = None
    if np.isfinite(points).all():
        # The volume shows the needle where it lay in P.
        in_probe = RigidTransform(log.X_WP[nearest]).inverse().multiply(points[[0, -1]].T)
        true = NeedleCurve(volume.X_WP.multiply(in_probe).T)
    mode = TrackingMode(row.mode) if row is not None else TrackingMode.SEARCHING
    return png(plot_planes([
        picture_planes(volume, mode, estimated), picture_planes(volume, mode, true)
    ]))  # fmt: skip


def summarize(outcomes: Sequence[Outcome], *, salt: int = 0, quick: bool = False) -> dict[str, Any]:
    """Return the contents of benchmark.json: records, and scores with intervals over them."""
    trackers = [each["name"] for each in outcomes[0].case.settings["entrants"]]
    suites = list(dict.fromkeys(each.case.experiment for each in outcomes))
    records = [
        {"suite": each.case.experiment, "seed": each.case.seed, **each.result}
        for each in outcomes
        if each
    ]
    scores: dict[str, Any] = {}
    for tracker in trackers:
        scores[tracker] = {}
        for suite in (*suites, ALL):
            own = [each[tracker] for each in records if suite in (ALL, each["suite"])]
            if own:
                scores[tracker][suite] = score(own)
    return {
        "version": VERSION,
        "salt": salt,
        "quick": quick,
        "made_with": {**made_with(), "sonoservo's code": code_fingerprint(__name__)},
        "sequences": len(outcomes),
        "failed": [
            {"suite": each.case.experiment, "seed": each.case.seed, "error": each.error}
            for each in outcomes
            if not each
        ],
        "scores": scores,
        "reliability": {
            tracker: reliability([each[tracker] for each in records]) for tracker in trackers
        },
        "records": records,
    }
