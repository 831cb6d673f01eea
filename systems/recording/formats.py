"""Formats of files with volumes or 2D frames, by suffix."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.nifti_reader import open_nifti
from sonoservo.systems.files.nrrd_reader import open_nrrd
from sonoservo.systems.files.plus_fields import as_plus_means
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures, require_extra
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.recording.dicom import open_dicom
from sonoservo.systems.recording.meta_image import open_meta_image
from sonoservo.systems.recording.png_folder import open_png_folder
from sonoservo.systems.recording.tus_rec import open_tus_rec
from sonoservo.systems.recording.volume_folder import open_volume_folder
from sonoservo.systems.recording.zea import open_zea


def open_hdf5(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open an HDF5 file of TUS-REC or of zea."""
    h5py = require_extra("h5py", "hdf5", path)
    with refusing_failures(path, "it is no HDF5 file"), h5py.File(path, "r") as file:
        names = set(file)
    if "frames" in names:
        return open_tus_rec(path, frames=frames)
    if "data" in names:
        return open_zea(path, frames=frames)
    raise ConfigurationError(
        f"{path}: it is no scan of TUS-REC (frames, tforms), nor a file of zea (data)"
    )


FORMATS: dict[str, Callable[..., VolumeFile]] = {
    ".nrrd": open_nrrd,
    ".nhdr": open_nrrd,
    ".mha": open_meta_image,
    ".mhd": open_meta_image,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
    ".dcm": open_dicom,
    ".nii": open_nifti,
    ".nii.gz": open_nifti,
}
"""Openers of files, called with a path and ``frames``."""


def open_file(path: Path, *, frames: bool = False, orientation: str = "") -> VolumeFile:
    """Open a file of volumes, or of 2D ``frames``, by its suffix, with the axes that PLUS means."""
    if path.is_dir():
        return as_plus_means(_open_folder(path, frames=frames), orientation)
    if not path.is_file():
        raise ConfigurationError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise ConfigurationError(f"{path}: it is empty")
    suffix = _suffix(path)
    if suffix not in FORMATS:
        raise ConfigurationError(
            f"{path}: this file type is not supported; use {', '.join(FORMATS)}, and write arrays "
            "with RecordingWriter"
        )
    return as_plus_means(_open_numbered(path, frames=frames), orientation)


def _open_numbered(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a file, and tell or refuse fields with numbers beyond those of its volumes or frames."""
    file = FORMATS[_suffix(path)](path, frames=frames)
    there = counted(file.count, "frame" if frames else "volume")
    notes = []
    for name, values in file.frame_fields().items():
        first, last = (f"Seq_Frame{number:04d}_{name}" for number in (min(values), max(values)))
        if max(values) < file.count:
            continue
        if min(values) > 0:  # each might be that of its neighbour
            raise ConfigurationError(
                f"{path}: {first} to {last}: the file holds {there}, counted from 0"
            )
        notes.append(f"{last} has no effect: the file holds {there}, counted from 0")
    return replace(file, notes=(*file.notes, *notes[:1]))


def _suffix(path: Path) -> str:
    return ".nii.gz" if path.name.lower().endswith(".nii.gz") else path.suffix.lower()


def _open_folder(path: Path, *, frames: bool) -> VolumeFile:
    visible = [each for each in path.iterdir() if not each.name.startswith(".")]
    if images := [each for each in visible if _suffix(each) == ".png"]:
        return open_png_folder(path, images, frames=frames)
    files = [] if frames else [each for each in visible if _suffix(each) in FORMATS]
    if not files:
        held = "PNG images" if frames else f"volumes ({', '.join(FORMATS)})"
        raise ConfigurationError(f"{path}: it is a folder without {held}")
    return open_volume_folder(path, files, _open_numbered)
