"""One labelled sequence of a data set."""

from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core import config
from pydrake.math import RigidTransform

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.diagrams.studies.dataset_draws import draw_insertion, draw_scanner
from sonoservo.diagrams.studies.dataset_labels import (
    describe_needle,
    needle_as_acquired,
    needle_mask,
)
from sonoservo.diagrams.studies.study import Case, WithFiles
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.nrrd import write_mask
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer

FORMAT = 2
"""Format version of manifest.json and labels.json."""

_FIRST_VOLUME = 1.1
"""Start of the first volume in s, after the push that no volume shows."""


def make_sequence(case: Case) -> WithFiles:
    """Make a sequence, and return its entry in the manifest and its files.

    Parameters
    ----------
    case
        Case with the seed, and with the settings `scenario` (YAML), `volumes` and `transducers`.
    """
    name = f"sequence_{case.seed:05d}"
    with TemporaryDirectory() as folder:
        labels = _write_sequence(case, Path(folder))
        files = {
            f"{name}/{path.name}": path.read_bytes() for path in sorted(Path(folder).iterdir())
        }
    entry = {
        "folder": name,
        "seed": case.seed,
        "volumes": labels,
        "processor": config.CPU_NAME or binding.get_host_cpu_name(),
    }
    return WithFiles(entry, files)


def _write_sequence(case: Case, folder: Path) -> int:
    """Write a sequence, and return its number of volumes."""
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
    return len(labels)


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
