"""Labelled sequences for training networks: volumes, needle, tip and mask."""

import json
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.studies.datasets.dataset_sequence import (
    FORMAT,
    LAYOUTS,
    make_sequence,
    nnunet_files,
)
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.store import Store, absolute
from sonoservo.diagrams.studies.study import Case, Executor, Outcome
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.files.writing import to_json, write_json
from sonoservo.systems.ultrasound.transducer import load_transducer

MANIFEST = "manifest.json"  # name of the list of all sequences in a store
_MOST = 1_000_000  # largest number of sequences, or of volumes in one

_SEQUENCE = re.compile(r"sequence_\d+")

_REPRODUCIBLE = (
    "The same seed gives the same bytes on the same type of processor with the same versions; "
    "otherwise within one grey level in 99.9 % of the voxels."
)


def make_dataset(
    scenario: Scenario,
    out: Path,
    *,
    count: int,
    volumes: int = 10,
    transducers: Sequence[str] = (),
    randomize: bool = False,
    layout: str = "sequences",
    store: str | None = None,
    jobs: int = -1,
    cluster: Executor | None = None,
    console: Console | None = None,
) -> dict[str, Any]:
    """Make labelled sequences with a different needle, tissue and probe each.

    The probe is held still. The scenario provides the scanner's settings, the grid and the phantom;
    needle, pose, tissue, transducer, gain, frequency and focus are drawn by the sequence's seed,
    counted up from `scenario.seed`. Complete sequences from an earlier call are kept and listed.

    Parameters
    ----------
    scenario
        Scenario of following, with the seed of the first sequence.
    out
        Folder for the outcomes and a copy of manifest.json.
    count, volumes
        Number of sequences, and of volumes in each, at the scenario's rate.
    transducers
        Probes to draw from, by name or path; empty for the scenario's.
    randomize
        Whether to also draw the dials of the harder world; see `draw_dials`.
    layout
        One of the `LAYOUTS`.
    store
        Folder or URL of fsspec for manifest.json and the sequences, which the workers of a cluster
        write to; by default, everything comes back into ``out``.
    jobs, cluster, console
        See `run_cases`.

    Returns
    -------
    Contents of manifest.json.

    Raises
    ------
    ConfigurationError
        If a number or a transducer is not allowed, or the store's manifest is damaged.
    """
    scenario = require_scenario(scenario, FollowingScenario)
    for name, value in (("count", count), ("volumes", volumes)):
        if not 1 <= value <= _MOST:
            allowed = f"at least 1 and at most {_MOST}"
            raise ConfigurationError(f"{name}: {value} is not allowed; it must be {allowed}")
    if not (jobs >= 1 or jobs == -1):
        raise ConfigurationError(f"jobs: {jobs} is not allowed; it must be 1 or more, or -1")
    if layout not in LAYOUTS:
        raise ConfigurationError(f"layout: {layout!r} is not allowed; {suggest(layout, LAYOUTS)}")
    try:
        for name in transducers:
            load_transducer(name)
    except FileNotFoundError as error:
        raise ConfigurationError(str(error)) from error
    settings = {
        "scenario": scenario.to_yaml(),
        "volumes": volumes,
        "transducers": list(transducers) or [scenario.probe],
        "randomize": randomize,
        "layout": layout,
    }
    seeds = range(scenario.seed, scenario.seed + count)
    cases = [Case("sequence", seed, settings) for seed in seeds]
    place = Store(str(out)) if store is None else Store(absolute(store), shared=True)
    merged = _read_manifest(place)
    outcomes = run_cases(
        make_sequence,
        cases,
        out / "cases",
        jobs=jobs,
        cluster=cluster,
        store=place,
        console=console,
    )
    manifest = _merge(merged, [_entry(each, scenario.name) for each in outcomes])
    place.remove(_unlisted(place.sizes(), manifest))
    listed = nnunet_files(manifest["sequences"]) | {MANIFEST: to_json(manifest).encode()}
    place.write(listed)
    if store is not None:
        write_json(out / MANIFEST, manifest)
    return manifest


def _entry(outcome: Outcome, scenario: str) -> dict[str, Any]:
    """Return a sequence's entry in the manifest."""
    seed = outcome.case.seed
    if not outcome:
        return {"seed": seed, "error": outcome.error}
    return {"scenario": scenario, **outcome.result, "files": dict(outcome.files)}


def _merge(manifest: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a manifest with further entries, which replace those of the same seeds."""
    known = {each["seed"]: each for each in (*manifest["sequences"], *manifest["failed"])}
    known |= {each["seed"]: each for each in entries}
    ordered = [known[seed] for seed in sorted(known)]
    return {
        "format": FORMAT,
        "version": version("sonoservo"),
        "reproducible": _REPRODUCIBLE,
        "sequences": [each for each in ordered if "error" not in each],
        "failed": [each for each in ordered if "error" in each],
    }


def _read_manifest(store: Store) -> Mapping[str, Any]:
    """Return the manifest of a store; an empty one if there is none."""
    data = store.read(MANIFEST)
    if data is None:
        return {"sequences": [], "failed": []}
    try:
        manifest = json.loads(data)
        if manifest["format"] != FORMAT:
            raise ValueError(f"its format is {manifest['format']}, not {FORMAT}")
        _merge(manifest, [])
    except (ValueError, LookupError, TypeError) as error:
        raise ConfigurationError(
            f"{store}/{MANIFEST}: cannot be merged with ({error}); give another store"
        ) from error
    return manifest


def _unlisted(names: Mapping[str, int], manifest: Mapping[str, Any]) -> list[str]:
    """Return the files of listed sequences that the manifest does not name."""
    files = {each["name"]: each["files"] for each in manifest["sequences"]}
    found = [(name, _SEQUENCE.search(name)) for name in names]
    return [
        name for name, match in found if match and match[0] in files and name not in files[match[0]]
    ]
