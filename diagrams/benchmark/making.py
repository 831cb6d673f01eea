"""Volumes of the benchmark as files, with poses, truth, checksums and a data card."""

import json
from functools import partial
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sonoservo.diagrams.benchmark.benchmark import BenchmarkOptions
from sonoservo.diagrams.benchmark.entrants import sequence_name
from sonoservo.diagrams.benchmark.sequence import VERSION, Sequence, acquire_sequence, load_suites
from sonoservo.diagrams.studies.fingerprint import made_with
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.store import Store, absolute
from sonoservo.diagrams.studies.study import Case, Outcome, WithFiles
from sonoservo.systems.files.refusals import ConfigurationError, require_extra
from sonoservo.systems.files.writing import write_atomically, write_json
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.recording.side_files import TRUTH, LinesWriter
from sonoservo.systems.recording.zea import ZeaWriter

FORMATS = ("nrrd", "zea")
"""Formats of the volumes: ``NAME.seq.nrrd`` with side files, and ``NAME.hdf5`` of zea."""

_FORCE = 2.0  # contact force in N that the planned indentation stands for


def make_volumes(
    options: BenchmarkOptions, formats: tuple[str, ...] = FORMATS, store: str | None = None
) -> list[Outcome]:
    """Write sequences, manifest, checksums and README.md; a second call goes on."""
    for each in formats:
        if each not in FORMATS:
            raise ConfigurationError(
                f"format: {each!r} is not allowed; one of {', '.join(FORMATS)}"
            )
    if "zea" in formats:
        require_extra("h5py", "hdf5", "format zea")
    place = Store(str(options.folder)) if store is None else Store(absolute(store), shared=True)
    outcomes = run_cases(
        partial(write_sequence, formats=formats), options.cases(formats=list(formats)),
        options.folder / "cases", jobs=options.jobs, cluster=options.cluster, store=place,
        console=options.console,
    )  # fmt: skip
    done = [each for each in outcomes if each]
    sums = sorted((name, about["sha256"]) for each in done for name, about in each.files.items())
    write_json(options.folder / "manifest.json", {
        "version": VERSION, "salt": options.salt, "made_with": dict(made_with()),
        "sequences": [dict(each.result) for each in done],
        "failed": [{"name": sequence_name(each.case.experiment, each.case.seed),
                    "error": each.error} for each in outcomes if not each],
    })  # fmt: skip
    sha256sums = "".join(f"{digest}  {name}\n" for name, digest in sums)
    write_atomically(options.folder / "SHA256SUMS", sha256sums)
    size = sum(about["bytes"] for each in done for about in each.files.values())
    write_atomically(options.folder / "README.md", data_card(len(done), size, options.salt))
    return outcomes


def write_sequence(case: Case, formats: tuple[str, ...] = FORMATS) -> WithFiles:
    """Make a sequence, and return its files."""
    sequence = acquire_sequence(case.settings, case.seed)
    name = sequence_name(case.experiment, case.seed)
    with TemporaryDirectory() as folder:
        _write(sequence, Path(folder), name, formats)
        made = {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}
    entry = {
        "name": name, "suite": case.experiment, "seed": case.seed,
        "volumes": len(sequence.volumes), "lifted_s": list(sequence.lifted),
    }  # fmt: skip
    return WithFiles(entry, made)


def _write(sequence: Sequence, folder: Path, name: str, formats: tuple[str, ...]) -> None:
    recording = folder / f"{name}.seq.nrrd"
    if "nrrd" in formats:
        with RecordingWriter(recording, {"tracker_seed": sequence.tracker_seed}) as writer:
            for volume in sequence.volumes:
                writer.append(volume)
    if "zea" in formats:
        with ZeaWriter(folder / f"{name}.hdf5") as zea:
            for volume in sequence.volumes:
                zea.append(volume)
    log = sequence.truth
    about = {"needle_radius": sequence.needle_radius}
    with LinesWriter(recording, TRUTH, about) as truth:
        for time, points in zip(log.time, log.needle_points, strict=True):
            known = bool(np.isfinite(points).all())
            truth.append({"time": float(time), "needle": points.tolist() if known else [],
                          "contact_force": _FORCE})  # fmt: skip


def data_card(sequences: int, size: int, salt: int) -> str:
    """Return the data card: what the volumes are, how they were made, and what they are not for."""
    folder = Path(str(files("sonoservo.diagrams.benchmark")))
    suites = "\n".join(f"| {name} | {each.line} |" for name, each in load_suites().items())
    return (folder / "data_card.md").read_text(encoding="utf-8").format(
        version=VERSION, package=version("sonoservo"), sequences=sequences,
        gigabytes=f"{1e-9 * size:.2f}", salt=salt, suites=suites,
        made_with=json.dumps(dict[str, Any](made_with())),
    )  # fmt: skip
