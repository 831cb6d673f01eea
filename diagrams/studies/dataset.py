"""Labelled sequences for people who train networks: volumes, needle, tip and mask."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from rich.console import Console

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.studies.study import Case, run_cases
from sonoservo.systems.files.typed_yaml import ConfigurationError
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import InsertionParameters, Push
from sonoservo.systems.recording.nrrd import write_mask
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Fibre, Tissue, load_tissue
from sonoservo.systems.ultrasound.transducer import load_transducer

FORMAT = 1
"""Version of manifest.json and labels.json."""

_OUTSIDE = 15e-3
"""Length of needle in the tissue before it enters the field of view, in m."""

_FIRST_VOLUME = 1.1
"""When the first volume begins, in s: the hand has then pushed in what no volume shows go in."""

_INDENTATION = 4e-3
"""How deep the probe sinks into the phantom, in m."""


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
    """Make labelled sequences, each of another needle, tissue and probe; the probe is held still.

    The scenario gives the settings of the scanner, the grid and the arm's phantom; drawn are where
    the needle enters, its angle, bend, gauge and speed, where the probe stands, the tissue with its
    inclusions, the transducer and what is assumed of it, gain, frequency and focus. Whatever is
    drawn follows from the sequence's seed, `scenario.seed` and up. What is made already is kept, if
    it is whole.

    Parameters
    ----------
    scenario
        With the seed of the first sequence.
    out
        Folder: manifest.json, and for each sequence a folder with volumes.seq.nrrd,
        volumes.acquisition.jsonl, mask_000.seg.nrrd and so on, and labels.json.
    count
        Number of sequences.
    volumes
        In each, at the scenario's rate.
    transducers
        To choose from, by name or path; none means the scenario's.
    jobs
        Processes; -1 means one for each core.
    console
        Where to show progress.

    Returns
    -------
    The manifest.

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
    """Whether all files of a sequence are there, as large as they were."""
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
    drawn = _draw_scanner(scenario, list(case.settings["transducers"]), rng)
    renderer: SweepRenderer = drawn.pop("renderer")
    X_TP, hand = _draw_insertion(scenario, renderer.geometry, case.settings["volumes"], rng)
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
            labels.append({"volume": number, "time_s": volume.time, **_describe(needle)})
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


def _draw_scanner(
    scenario: FollowingScenario, transducers: list[str], rng: np.random.Generator
) -> dict[str, Any]:
    """Draw transducer, settings and tissue; with the renderer that they make."""
    name = transducers[rng.integers(len(transducers))]
    transducer = load_transducer(name)
    # What the makers do not publish.
    transducer = replace(
        transducer,
        element_height=transducer.element_height * rng.uniform(0.8, 1.2),
        lens_focus=transducer.lens_focus * rng.uniform(0.8, 1.25),
        fractional_bandwidth=rng.uniform(0.5, 0.8),
    )
    low, high = transducer.lowest_frequency, transducer.highest_frequency
    imaging = replace(
        scenario.imaging,
        gain=rng.uniform(0.34, 0.5),
        transmit_frequency=rng.uniform(low, min(high, 1.3 * low)),
        focus_depth=rng.uniform(0.025, 0.06),
    )
    tissue = _draw_tissue(load_tissue(scenario.phantom), rng)
    renderer = SweepRenderer(
        transducer=transducer,
        imaging=imaging,
        tissue=tissue,
        parameters=scenario.scanner,
        seed=int(rng.integers(1 << 31)),
    )
    return {
        "renderer": renderer,
        "transducer": {"name": name, **asdict(transducer)},
        "imaging": asdict(imaging),
        "tissue": asdict(tissue),
    }


def _draw_tissue(tissue: Tissue, rng: np.random.Generator) -> Tissue:
    """Draw speckle, attenuation and bright inclusions."""
    half = 0.5 * np.array(tissue.size) * [1, 1, 0]
    low, high = -half - [0, 0, tissue.size[2]], half

    def point() -> NDArray[np.float64]:
        return rng.uniform(0.95 * low, 0.95 * high - [0, 0, 0.015])

    fibres = []
    for _ in range(rng.integers(3, 9)):
        start = point()
        step = rng.normal(size=3) * [1, 1, 0.2]
        end = start + rng.uniform(5e-3, 15e-3) * step / np.linalg.norm(step)
        fibres.append(
            Fibre(start=start.tolist(), end=np.clip(end, low, high).tolist(), level_db=34.0)
        )
    return replace(
        tissue,
        scatterers_per_cell=rng.uniform(2, 8),
        attenuation=rng.uniform(0.3, 0.7),
        balls=[
            Ball(
                centre=point().tolist(),
                radius=rng.uniform(0.8e-3, 1.8e-3),
                level_db=rng.uniform(24, 32),
            )
            for _ in range(rng.integers(6, 16))
        ],
        fibres=fibres,
        seed=int(rng.integers(1 << 31)),
    )


def _draw_insertion(
    scenario: FollowingScenario, geometry: SweepGeometry, volumes: int, rng: np.random.Generator
) -> tuple[RigidTransform, InsertionParameters]:
    """Draw where the probe stands, X_TP, and a needle that comes into its view from the side."""
    station = scenario.station
    X_TP = station.X_WT.InvertAndCompose(
        station.probe_pose(
            x=rng.uniform(-0.05, 0.05),
            y=rng.uniform(-0.01, 0.01),
            yaw_deg=rng.uniform(-90, 90),
            height=-_INDENTATION,
        )
    )
    side = rng.choice([0, geometry.lines - 1])
    while True:
        frame = (geometry.frames - 1) * rng.uniform(0.35, 0.65)
        depth = geometry.depth * rng.uniform(0.2, 0.7)
        p_PSide = geometry.position(frame, side, depth / geometry.sample_pitch, 1)
        dip, turn = np.deg2rad([rng.uniform(0, 30), rng.uniform(-15, 15)])
        inwards = 1 if side == 0 else -1
        k = np.array(
            [inwards * np.cos(turn) * np.cos(dip), np.sin(dip), np.cos(dip) * np.sin(turn)]
        )
        length = rng.uniform(10e-3, 80e-3)
        if geometry.contains(p_PSide + np.outer([0.1 * length, length], k)).all():
            break
    entry, direction = X_TP.multiply(p_PSide - _OUTSIDE * k), X_TP.rotation() @ k
    duration = (volumes + 1) * geometry.period
    speed = min(length / duration, rng.uniform(2e-3, 12e-3))
    # The first volume comes when all is in that the last ones do not see go in.
    before = _OUTSIDE + length - speed * duration
    return X_TP, replace(
        scenario.hand,
        gauge=int(rng.choice([17, 18, 20])),
        entry=entry.tolist(),
        entry_spread=[0.0, 0.0, 0.0],
        angle_spread_deg=0.0,
        azimuth_deg=float(np.rad2deg(np.arctan2(direction[1], direction[0]))),
        dip_deg=float(np.rad2deg(-np.arcsin(direction[2]))),
        bend_radius=float(rng.uniform(0.2, 0.6)) if rng.random() < 0.3 else None,
        bend_roll_deg=float(rng.uniform(-180, 180)),
        start=0.0,
        pushes=[Push(duration=1.0, speed=before), Push(duration=duration, speed=speed)],
        ramp=0.1,
    )


def _acquire(
    renderer: SweepRenderer,
    conversion: ScanConversion,
    insertion: Insertion,
    X_TP: RigidTransform,
    number: int,
) -> Volume:
    """Acquire a volume; the tissue's frame is the world's."""
    geometry, direction = renderer.geometry, 1 - 2 * (number % 2)
    begin = _FIRST_VOLUME + number * geometry.period
    times = geometry.frame_times(begin, direction)
    needles = [insertion.needle(float(time)) for time in times]
    motion = SweepMotion.at_rest(geometry, X_TP, times, direction)
    return conversion(acquire_sweep(renderer, motion, needles, number=number))


def needle_as_acquired(volume: Volume, insertion: Insertion) -> Needle:
    """The needle in P, as deep as it was when the volume's frames saw its tip."""
    time = volume.time
    for _ in range(4):
        needle = insertion.needle(time).transformed(volume.X_WP.inverse())
        if needle:
            time = float(volume.to_world(needle.tip[np.newaxis])[1][0])
    return needle


def needle_mask(volume: Volume, needle: Needle) -> NDArray[np.bool_]:
    """Voxels of a volume that the needle, given in P, passes through, where the image shows them.

    That is where their centres lie within its radius, or, as it is thinner than some grids, within
    0.75 of the largest spacing of its axis.
    """
    mask: NDArray[np.bool_] = np.zeros(volume.intensities.shape, dtype=bool)
    radius = max(needle.radius, 0.75 * float(volume.spacing.max()))
    last = np.array(volume.intensities.shape)
    for a, b in zip(needle.shaft[:-1], needle.shaft[1:], strict=True):
        low = (np.minimum(a, b) - radius - volume.origin) / volume.spacing
        high = (np.maximum(a, b) + radius - volume.origin) / volume.spacing
        first = np.clip(np.ceil(low), 0, last).astype(int)
        stop = np.clip(np.floor(high) + 1, first, last).astype(int)
        box = tuple(slice(int(i), int(j)) for i, j in zip(first, stop, strict=True))
        index = np.stack(np.meshgrid(*map(np.arange, first, stop), indexing="ij"), axis=-1)
        p_P, k = volume.position(index) - a, b - a
        along = np.clip(p_P @ k / (k @ k), 0, 1)
        mask[box] |= np.linalg.norm(p_P - along[..., np.newaxis] * k, axis=-1) <= radius
    return mask & (volume.intensities > 0)


def _describe(needle: Needle) -> dict[str, Any]:
    """Labels of a volume, in its own coordinates: LPS in mm, which are the axes of P."""
    if not needle:
        return {"needle_lps_mm": [], "tip_lps_mm": None, "radius_mm": 1e3 * needle.radius}
    return {
        "needle_lps_mm": (1e3 * needle.shaft).tolist(),
        "tip_lps_mm": (1e3 * needle.tip).tolist(),
        "radius_mm": 1e3 * needle.radius,
    }
