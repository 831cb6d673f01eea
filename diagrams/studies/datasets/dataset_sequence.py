"""One labelled sequence of a data set."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from llvmlite import binding
from numba.core import config
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.diagrams.studies.datasets.dataset_draws import (
    DrawnDials,
    DrawnScanner,
    draw_dials,
    draw_insertion,
    draw_scanner,
)
from sonoservo.diagrams.studies.study import Case, WithFiles
from sonoservo.systems.files.writing import to_json
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.nrrd import write_mask, write_volume
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.recording.zea import ZeaWriter
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation

FORMAT = 2  # format version of manifest.json and of the labels
_FIRST_VOLUME = 1.1  # start of the first volume in s, after the push that no volume shows


@cache
def processor_type() -> str:
    """Return the type of processor for which the kernels are compiled."""
    return str(config.CPU_NAME or binding.get_host_cpu_name())


def make_sequence(case: Case) -> WithFiles:
    """Make a sequence, and return its entry in the manifest and its files."""
    settings, name = case.settings, f"sequence_{case.seed:05d}"
    dials = DrawnDials()
    if settings["randomize"]:
        dials = draw_dials(np.random.default_rng([case.seed, 8]))
    data = yaml.safe_load(settings["scenario"])
    loaded = load_scenario(data, changes=list(dials.changes), seed=case.seed)
    scenario = require_scenario(loaded, FollowingScenario)
    rng = np.random.default_rng([case.seed, 3])
    scanner = draw_scanner(scenario, list(settings["transducers"]), rng)
    X_TP, hand = draw_insertion(scenario, scanner.geometry, settings["volumes"], rng, dials)
    scene = _Scene(scenario, scanner, Insertion(hand, rng), X_TP)
    labels: list[dict[str, Any]] = []

    def volumes() -> Iterator[Labelled]:
        for number in range(settings["volumes"]):
            volume, needle = scene.acquire(number)
            labels.append({"volume": number, "time_s": volume.time, **describe_needle(needle)})
            yield volume, needle_mask(volume, needle)

    about = {
        "format": FORMAT,
        "seed": case.seed,
        "dials": dials.strengths,
        **scanner.labels(),
        "hand": asdict(hand),
    }
    files = write_layout(settings["layout"], name, volumes(), lambda: {**about, "volumes": labels})
    entry = {"name": name, "seed": case.seed, "volumes": len(labels), "processor": processor_type()}
    return WithFiles(entry, files)


class _Scene:
    """Scanner, tissue and needle of a sequence; the tissue's frame at rest is the world frame.

    The resting probe follows the breath from volume to volume, so the tissue breathes relative to
    the middle of each sweep.
    """

    def __init__(
        self,
        scenario: FollowingScenario,
        scanner: DrawnScanner,
        insertion: Insertion,
        X_TP: RigidTransform,
    ) -> None:
        self._scenario, self._insertion, self._X_TP = scenario, insertion, X_TP
        self._scene = scanner.scene(insertion, scenario)
        self._acoustic = scanner.acoustic_geometry
        spacing = scenario.scan_conversion.spacing
        self._conversion = ScanConversion(scanner.geometry, make_grid(scanner.geometry, spacing))

    def acquire(self, number: int) -> tuple[Volume, Needle]:
        """Return a volume, and the needle in P as the volume shows it."""
        geometry, direction = self._scene.geometry, 1 - 2 * (number % 2)
        begin = _FIRST_VOLUME + number * geometry.period
        times = geometry.frame_times(begin, direction)
        motion = SweepMotion.at_rest(geometry, self._X_TP, times, direction)
        breathing = self._scenario.phantom_motion.breathing
        poses = motion.X_WP.copy()
        away = np.array([breathing.displacement(float(time)) for time in times])
        poses[:, :3, 3] -= away - breathing.displacement(motion.time)
        acquired = self._scene.acquire(motion, poses, number=number)
        volume = self._conversion(acquired.sweep)
        needle = needle_as_acquired(volume, self._insertion)
        slowed = self._acoustic.sample_pitch != geometry.sample_pitch
        if acquired.deformations is not None or away.any() or slowed:
            needle = needle_as_imaged(
                needle.transformed(self._X_TP),
                poses,
                acquired.deformations,
                self._acoustic,
                geometry,
                direction,
            )
        return volume, needle


_SPACING = 2e-3  # largest distance between points of a needle that the tissue bends, in m


def needle_as_acquired(volume: Volume, insertion: Insertion) -> Needle:
    """Return the needle in P, as deep as it was when the volume's frames saw its tip."""
    time = volume.time
    for _ in range(4):
        needle = insertion.needle(time).transformed(volume.X_WP.inverse())
        if needle:
            time = float(volume.to_world(needle.tip[np.newaxis])[1][0])
    return needle


def needle_as_imaged(
    needle: Needle,
    X_TP: NDArray[np.float64],
    deformations: Sequence[Deformation] | None,
    acoustic: SweepGeometry,
    geometry: SweepGeometry,
    direction: int,
) -> Needle:
    """Return a needle in P as a sweep shows it: each point by its own frame, at the depth shown."""
    if not needle:
        return needle
    count = max(len(needle.shaft), int(np.ceil(needle.length / _SPACING)) + 1)
    shafts = []
    for number, X in enumerate(X_TP):
        moved = needle if deformations is None else deformations[number].moved_needle(needle)
        p_T = moved.position(np.linspace(0, moved.length, count))
        shafts.append(RigidTransform(X).inverse().multiply(p_T.T).T)
    points, each = np.array(shafts), np.arange(count)
    frame = np.full(count, len(points) // 2)
    for _ in range(4):
        k = acoustic.index(points[frame, each], direction)[0]
        frame = np.clip(np.rint(k), 0, len(points) - 1).astype(int)
    k, j, i = acoustic.index(points[frame, each], direction)
    shaft = geometry.position(k, j, i, direction)
    return Needle(shaft, needle.radius, roll=needle.roll)


def needle_mask(volume: Volume, needle: Needle) -> NDArray[np.bool_]:
    """Return the mask of seen voxels within a needle's radius, or 0.75 spacings, of its axis."""
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
    return mask & volume.seen


def describe_needle(needle: Needle) -> dict[str, Any]:
    """Return the labels of a volume in its own coordinates: LPS in mm, along the axes of P."""
    if not needle:
        return {"needle_lps_mm": [], "tip_lps_mm": None, "radius_mm": 1e3 * needle.radius}
    return {
        "needle_lps_mm": (1e3 * needle.shaft).tolist(),
        "tip_lps_mm": (1e3 * needle.tip).tolist(),
        "radius_mm": 1e3 * needle.radius,
    }


Labelled = tuple[Volume, NDArray[np.bool_]]  # a volume and the mask of the needle in it

_FOLDS = 5


def _as_sequence(name: str, volumes: Iterable[Labelled], folder: Path) -> None:
    """Write a recording of all volumes, and a segmentation for each."""
    (folder / name).mkdir()
    with RecordingWriter(folder / name / "volumes.seq.nrrd") as writer:
        for number, (volume, mask) in enumerate(volumes):
            writer.append(volume)
            write_mask(folder / name / f"mask_{number:03d}.seg.nrrd", volume, mask, "needle")


def _as_nnunet(name: str, volumes: Iterable[Labelled], folder: Path) -> None:
    """Write an image and a label map for each volume."""
    for number, (volume, mask) in enumerate(volumes):
        one = f"{name}_{number:03d}"
        write_volume(folder / "imagesTr" / f"{one}_0000.nrrd", volume)
        write_mask(folder / "labelsTr" / f"{one}.nrrd", volume, mask, "needle")


def _as_zea(name: str, volumes: Iterable[Labelled], folder: Path) -> None:
    """Write a file of zea with the volumes and the segmentation of each."""
    with ZeaWriter(folder / name / "volumes.hdf5") as writer:
        for volume, mask in volumes:
            writer.append(volume, mask)


LAYOUTS: Mapping[str, tuple[Callable[[str, Iterable[Labelled], Path], None], str]] = {
    "sequences": (_as_sequence, "{}/labels.json"),
    "nnunet": (_as_nnunet, "labels/{}.json"),
    "zea": (_as_zea, "{}/labels.json"),
}
"""Writer of each layout, and the path of a sequence's labels in it."""


def write_layout(
    layout: str, name: str, volumes: Iterable[Labelled], labels: Callable[[], Mapping[str, Any]]
) -> dict[str, bytes]:
    """Return the files of a sequence in a layout."""
    write, path = LAYOUTS[layout]
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write(name, volumes, folder)
        found = sorted(each for each in folder.rglob("*") if each.is_file())
        files = {each.relative_to(folder).as_posix(): each.read_bytes() for each in found}
    files[path.format(name)] = to_json(labels()).encode()
    return files


def nnunet_files(sequences: Sequence[Mapping[str, Any]]) -> dict[str, bytes]:
    """Return nnU-Net's dataset.json and splits_final.json; sequences stay whole in the folds."""
    ending = ".nrrd"
    names = [
        [Path(file).stem for file in each["files"] if file.startswith("labelsTr/")]
        for each in sequences
    ]
    names = [each for each in names if each]
    if not names:
        return {}
    dataset = {
        "channel_names": {"0": "ultrasound"},
        "labels": {"background": 0, "needle": 1},
        "numTraining": sum(map(len, names)),
        "file_ending": ending,
        "overwrite_image_reader_writer": "SimpleITKIO",
        "name": "sonoservo",
        "description": "Simulated 3D ultrasound of needles; see manifest.json",
    }
    splits = [
        {
            "train": [one for k, each in enumerate(names) if k % _FOLDS != fold for one in each],
            "val": [one for each in names[fold::_FOLDS] for one in each],
        }
        for fold in range(_FOLDS)
    ]
    return {
        "dataset.json": to_json(dataset).encode(),
        "splits_final.json": to_json(splits).encode(),
    }
