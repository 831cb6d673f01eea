"""Fuzzer of files: recordings, tracked frames, side files, label maps, logs and kept outcomes."""

import io
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import nibabel
import nrrd
import numpy as np
from pydrake.math import RigidTransform
from recordings import tracked, write_meta_image, write_sequence_nrrd
from synthetic_logs import build_insertion_log
from tracked_frames import freehand, write_plus_file

from fuzzing.engine import Outcome, judge
from fuzzing.mutations import mutate
from sonoservo.diagrams.app.volumes.locate import locate_in_recording
from sonoservo.diagrams.app.volumes.opening import ReconstructedRecording
from sonoservo.diagrams.studies import runs, study
from sonoservo.diagrams.studies.store import Store
from sonoservo.systems.evaluation.log import read_log, write_log
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording, RecordingWriter, read_truth
from sonoservo.systems.recording.side_files import TRUTH, LinesWriter, side_path
from sonoservo.systems.signals import SweepGeometry, SweepMotion, Volume
from sonoservo.systems.ultrasound.simulation import load_tissue

SHAPE = (12, 14, 10)
PER_VOXEL = 40.0
"""Bytes that a voxel justifies, in all."""

Files = dict[str, bytes]
MADE_BY = {"code": "of the test"}
CASE = study.Case("a", 3, {"x": 1})
GOOD = study.Outcome(CASE, {"error_mm": 1.25, "n": [1, 2]}, "", 1.5, made_by=MADE_BY)


def _arrays(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(1, 256, SHAPE).astype(np.uint8) for _ in range(count)]


@cache
def bases() -> dict[str, tuple[Files, str, Callable[[Path, Random], float]]]:
    """Return valid files, the name of the one to open, and its reader, by a short name."""
    made = {}
    for name, (write, opened, read) in _MAKERS.items():
        with TemporaryDirectory() as folder:
            write(Path(folder) / opened)
            content = {each.name: each.read_bytes() for each in sorted(Path(folder).iterdir())}
            made[name] = content, opened, read
            read(Path(folder) / opened, Random(0))  # it is valid, and its code is compiled
    return made


def file_case(number: int, folder: Path, seed: int = 0) -> Outcome:
    """Damage one of the files of a valid set, and read the set."""
    rng = Random(f"files {seed} {number}")
    kind = rng.choice(sorted(bases()))
    files, opened, read = bases()[kind]
    victim = rng.choice(sorted(files))
    damaged, said = mutate(files[victim], _header(victim, files[victim]), rng)
    if number % 997 == 0:
        folder = folder / rng.choice(["[bold]", "é µ", "x" * 200, "a\nb"])
        folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(damaged if name == victim else content)
    size = sum(map(len, files.values())) + len(damaged)
    return judge(f"{kind} {victim} {said}", lambda: 50 * size + read(folder / opened, rng))


def _header(name: str, content: bytes) -> int:
    if name.endswith((".nrrd", ".nhdr")):
        return content.find(b"\n\n") + 2
    if name.endswith((".mha", ".mhd")):
        return content.find(b"\n", content.find(b"ElementDataFile")) + 1
    return 348 if name.endswith(".nii") else 0


def read_recording(path: Path, rng: Random) -> float:
    options = rng.choice([{}, {}, {}, {"poses": "none", "volume_rate": 3.0}, {"depth": "S"}])
    if rng.random() < 0.1:
        ends = [0.0, 1.0, 255.0, -1e300, 1e300, 1e-320, float("nan"), 1e9, 1e9 + 1]
        options = {"window": (rng.choice(ends), rng.choice(ends))}
    recording = Recording(path, **options)
    assert (np.diff(recording.times) > 0).all()
    assert np.abs(recording.times).max() < 1e12
    voxels = 0.0
    for number in {0, len(recording) - 1}:
        volume = recording[number]
        _require_sound(volume, recording.X_WL(number))
        voxels = float(volume.intensities.size)
    truth = side_path(path, TRUTH)
    if truth.is_file():
        sample = read_truth(truth).at(volume.time)
        assert sample >= 0
    if rng.random() < 0.05 and voxels < 1e6:
        locate_in_recording(recording, order=rng.choice([2, 3]))
    return PER_VOXEL * voxels


def _require_sound(volume: Volume, X_WL: RigidTransform) -> None:
    assert np.isfinite(volume.intensities).all()
    assert volume.intensities.min() >= 0
    assert volume.intensities.max() <= 255
    assert volume.intensities.flags.c_contiguous
    assert (volume.spacing >= 1e-5).all()
    assert (volume.spacing <= 0.02).all()
    assert (volume.upper - volume.origin <= 1.0).all()
    assert 0 < volume.decibels_per_level <= 4
    for pose in (volume.X_WP, X_WL):
        assert np.isfinite(pose.GetAsMatrix4()).all()
        assert np.abs(pose.translation()).max() < 1e3
        R = pose.rotation().matrix()
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-5


def read_frames(path: Path, rng: Random) -> float:
    spacing = rng.choice([7e-4, 2e-3, 2e-3, 2e-3])
    recording = ReconstructedRecording(path, spacing=spacing, frames=rng.choice([None, 5]))
    volume = recording[0]
    _require_sound(volume, RigidTransform())
    return PER_VOXEL * volume.intensities.size


def read_phantom(path: Path, rng: Random) -> float:
    tissue = load_tissue(str(path))
    assert np.isfinite(tissue.size).all()
    assert tissue.anatomy is not None
    return PER_VOXEL * (tissue.anatomy.grid().numbers.size + 1e6)


def read_run_log(path: Path, rng: Random) -> float:
    try:
        read_log(path, RunLog)
    except (ValueError, OSError) as error:
        raise ConfigurationError(str(error)) from error
    return 0.0


def read_outcome(path: Path, rng: Random) -> float:
    assert _kept(path.parent).read(CASE) in (None, GOOD), "an altered outcome was believed"
    return 0.0


def _write_recorded(path: Path) -> None:
    """Write a recording of this program, with its side files."""
    geometry = SweepGeometry(0.04, 0.0273, 0.01, 0.02, 5e-4, 10, 5, 80, 0.05)
    with (
        RecordingWriter(path, {"tracker_seed": 3}) as writer,
        LinesWriter(path, TRUTH, {"needle_radius": 5e-4}) as truth,
    ):
        for number, array in enumerate(_arrays(3)):
            time = 0.5 + 0.25 * number
            X_WP = RigidTransform([0.1, 0.2, 0.3])
            motion = SweepMotion.at_rest(geometry, X_WP, geometry.frame_times(time, since=2))
            volume = Volume(array, [-5e-3, 0, -4e-3], [7e-4] * 3, X_WP, time, motion)
            writer.append(volume)
            needle = [[0, 0, 0], [0.01, 0, 0.02]] if number else []
            truth.append({"time": time, "needle": needle, "contact_force": 2.0})


def _write_phantom(path: Path) -> None:
    labels = np.zeros(SHAPE, np.uint8)
    labels[3:8, 4:9, 2:7] = 1
    if path.suffix == ".nrrd":
        header = {"space": "LPS", "space directions": np.diag([4.0, 4, 4]), "encoding": "raw"}
        nrrd.write(str(path), labels, header)
    else:
        image = nibabel.Nifti1Image(labels, np.diag([4.0, 4, 4, 1]))
        image.header.set_xyzt_units("mm")
        nibabel.save(image, path)
    table = "tissue: {anatomy: {labels: [{label: 1, level_db: -6}]}}\n"
    path.with_name("map.yaml").write_text(table)


def _kept(folder: Path) -> runs._Kept:
    return runs._Kept(folder, Store(str(folder)), MADE_BY)


def _write_outcome(path: Path) -> None:
    assert _kept(path.parent).write(study.Finished(GOOD)) == GOOD


def _write_single(path: Path) -> None:
    buffer = io.BytesIO()
    header = {"space": "RAS", "space directions": np.diag([0.5] * 3), "encoding": "raw"}
    nrrd.write(buffer, (_arrays(1)[0] * 40.0).astype(np.float64), header, index_order="F")
    path.write_bytes(buffer.getvalue())


def _write_sequence(path: Path, **options: Any) -> None:
    write_sequence_nrrd(path, _arrays(3), **options)


def _write_meta(path: Path, **options: Any) -> None:
    write_meta_image(path, _arrays(3), tracked(3), **options)


_MAKERS = {
    "raw nrrd": (partial(_write_sequence, encoding="raw", **tracked(3)), "a.seq.nrrd",
                 read_recording),
    "list first": (partial(_write_sequence, list_first=True), "a.seq.nrrd", read_recording),
    "doubles": (_write_single, "a.nrrd", read_recording),
    "mha": (_write_meta, "a.mha", read_recording),
    "packed mha": (partial(_write_meta, compressed=True), "a.mha", read_recording),
    "mhd": (lambda path: write_meta_image(path, _arrays(1)), "a.mhd", read_recording),
    "recorded": (_write_recorded, "a.seq.nrrd", read_recording),
    "frames": (lambda path: write_plus_file(path, freehand(10, dtype=np.uint8)), "a.igs.mha",
               read_frames),
    "label map": (_write_phantom, "map.nrrd", read_phantom),
    "nifti": (_write_phantom, "map.nii", read_phantom),
    "packed nifti": (_write_phantom, "map.nii.gz", read_phantom),
    "log": (lambda path: write_log(path, build_insertion_log()), "log.npz", read_run_log),
    "outcome": (_write_outcome, f"{CASE.name}.json", read_outcome),
}  # fmt: skip
