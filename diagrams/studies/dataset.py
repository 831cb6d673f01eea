"""Labelled sequences for training networks: volumes, needle, tip and mask."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from rich.console import Console

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.studies.dataset_draws import draw_insertion, draw_scanner
from sonoservo.diagrams.studies.dataset_labels import (
    describe_needle,
    needle_as_acquired,
    needle_mask,
)
from sonoservo.diagrams.studies.study import Case, run_cases
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.nrrd import write_mask
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.transducer import load_transducer

FORMAT = 1
"""Format version of manifest.json and labels.json."""


_FIRST_VOLUME = 1.1
"""Start of the first volume in s, after the push that no volume shows."""


def make_dataset(
    scenario: Scenario,
    out: Path,
    *,
    count: int,
    volumes: int = 10,
    transducers: Sequence[str] = (),
    jobs: int = -1,
    console: Console | None = None,
) -> dict[str, Any]:
    """Make labelled sequences with a different needle, tissue and probe each.

    The probe is held still. The scenario provides the settings of the scanner, the grid and the
    phantom. Drawn at random are the entry, angle, bend, gauge and speed of the needle, the pose of
    the probe, the tissue with its inclusions, the transducer with its unpublished properties, and
    gain, frequency and focus. All draws follow from the sequence's seed, counted up from
    `scenario.seed`. Complete sequences from an earlier call are kept.

    Parameters
    ----------
    scenario
        Scenario of following, with the seed of the first sequence.
    out
        Folder: manifest.json, and for each sequence a folder with volumes.seq.nrrd,
        volumes.acquisition.jsonl, mask_000.seg.nrrd and so on, and labels.json.
    count
        Number of sequences.
    volumes
        Number of volumes in each sequence, at the scenario's rate.
    transducers
        Probes to draw from, by name or path; empty for the scenario's.
    jobs
        Number of processes; -1 for one per core.
    console
        Console on which to show progress, if any.

    Returns
    -------
    Contents of manifest.json.

    Raises
    ------
    ConfigurationError
        If a number or a transducer is not allowed.
    """
    scenario = require_scenario(scenario, FollowingScenario)
    for name, value in (("count", count), ("volumes", volumes)):
        if value < 1:
            raise ConfigurationError(f"{name}: {value} is not allowed; it must be at least 1")
    try:
        for name in transducers:
            load_transducer(name)
    except FileNotFoundError as error:
        raise ConfigurationError(str(error)) from error
    settings = {
        "scenario": scenario.to_yaml(),
        "volumes": volumes,
        "transducers": list(transducers) or [scenario.probe],
    }
    seeds = range(scenario.seed, scenario.seed + count)
    cases = [Case("sequence", seed, settings) for seed in seeds]
    kept = out / "cases"
    for case in cases:
        outcome = kept / f"{case.name}.json"
        if not _is_whole(outcome, out / _folder(case)):
            outcome.unlink(missing_ok=True)
    work = partial(_make_sequence, out=out)
    outcomes = run_cases(work, cases, kept, jobs=jobs, console=console)
    manifest = {
        "format": FORMAT,
        "version": version("sonoservo"),
        "scenario": scenario.name,
        "sequences": [dict(outcome.result) for outcome in outcomes if outcome],
        "failed": [
            {"seed": outcome.case.seed, "error": outcome.error}
            for outcome in outcomes
            if not outcome
        ],
    }
    write_json(out / "manifest.json", manifest)
    return manifest


def _folder(case: Case) -> str:
    return f"sequence_{case.seed:05d}"


def _is_whole(outcome: Path, folder: Path) -> bool:
    """Return True if all files of a sequence exist and have their recorded sizes."""
    try:
        files = json.loads(outcome.read_text(encoding="utf-8"))["result"]["files"]
        return all((folder / name).stat().st_size == file["bytes"] for name, file in files.items())
    except (OSError, ValueError, KeyError):
        return False


def _make_sequence(case: Case, *, out: Path) -> dict[str, Any]:
    """Make a sequence, and return its entry in the manifest."""
    folder = out / _folder(case)
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    scenario_file = folder / "scenario.yaml"
    scenario_file.write_text(case.settings["scenario"], encoding="utf-8")
    scenario = require_scenario(load_scenario(scenario_file, seed=case.seed), FollowingScenario)
    scenario_file.unlink()
    rng = np.random.default_rng([case.seed, 3])
    drawn = draw_scanner(scenario, list(case.settings["transducers"]), rng)
    renderer: SweepRenderer = drawn.pop("renderer")
    X_TP, hand = draw_insertion(scenario, renderer.geometry, case.settings["volumes"], rng)
    insertion = Insertion(hand, rng)
    conversion = ScanConversion(
        renderer.geometry, make_grid(renderer.geometry, scenario.scan_conversion.spacing)
    )
    labels = []
    with RecordingWriter(folder / "volumes.seq.nrrd") as writer:
        for number in range(case.settings["volumes"]):
            volume = _acquire(renderer, conversion, insertion, X_TP, number)
            needle = needle_as_acquired(volume, insertion)
            writer.append(volume)
            write_mask(
                folder / f"mask_{number:03d}.seg.nrrd",
                volume,
                needle_mask(volume, needle),
                "needle",
            )
            labels.append({"volume": number, "time_s": volume.time, **describe_needle(needle)})
    about = {"format": FORMAT, "seed": case.seed, **drawn, "hand": asdict(hand)}
    write_json(folder / "labels.json", {**about, "volumes": labels})
    files = {
        path.name: {
            "bytes": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path in sorted(folder.iterdir())
    }
    return {"folder": folder.name, "seed": case.seed, "volumes": len(labels), "files": files}


def _acquire(
    renderer: SweepRenderer,
    conversion: ScanConversion,
    insertion: Insertion,
    X_TP: RigidTransform,
    number: int,
) -> Volume:
    """Acquire a volume; the tissue's frame is the world frame."""
    geometry, direction = renderer.geometry, 1 - 2 * (number % 2)
    begin = _FIRST_VOLUME + number * geometry.period
    times = geometry.frame_times(begin, direction)
    needles = [insertion.needle(float(time)) for time in times]
    motion = SweepMotion.at_rest(geometry, X_TP, times, direction)
    return conversion(acquire_sweep(renderer, motion, needles, number=number))
