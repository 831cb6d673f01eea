"""Layouts of a data set's files: sequences of 3D Slicer, or the folders of nnU-Net."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.writing import to_json
from sonoservo.systems.recording.nrrd import write_mask, write_volume
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.recording.zea import ZeaWriter
from sonoservo.systems.signals.volume import Volume

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
