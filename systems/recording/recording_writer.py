"""Writes volumes as a recording: a sequence for 3D Slicer, and how they were acquired."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from sonoservo.systems.recording.sequence_writer import SUFFIX, SequenceWriter
from sonoservo.systems.recording.side_files import (
    ACQUISITION,
    LinesWriter,
    describe_acquisition,
    describe_grid,
)
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume


class RecordingWriter:
    """Writes volumes as they come: ``NAME.seq.nrrd`` and ``NAME.acquisition.jsonl``.

    A voxel lies where `write_volume` puts it, the volume's time is its index value, and X_WP is its
    field ``ProbeToReferenceTransform`` (in mm), as PLUS would write it. The acquisition holds the
    same to the last bit, and when and from where each frame was acquired. What was written before
    an interruption stays readable (`SequenceWriter`); `close` gives the files their names.

    Parameters
    ----------
    path
        Where to; it must end in ``.seq.nrrd``.
    settings
        What a tracker has to know besides; it goes into the acquisition's first line.

    Raises
    ------
    ValueError
        If the name ends otherwise.
    """

    def __init__(self, path: str | Path, settings: Mapping[str, Any] | None = None) -> None:
        self.path = Path(path)
        if not self.path.name.endswith(SUFFIX):
            raise ValueError(f"record: {self.path} is not allowed; it must end in {SUFFIX}")
        self._settings = dict(settings or {})
        self._volumes: SequenceWriter | None = None
        self._acquisition: LinesWriter | None = None
        self._grid: dict[str, Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def append(self, volume: Volume) -> None:
        """Write a volume.

        Raises
        ------
        ValueError
            If its grid, its scale of grey levels or its resolution differs from the first one's.
        """
        grid = describe_grid(volume)
        if self._volumes is None or self._acquisition is None:
            self._grid = grid
            self._volumes = SequenceWriter(self.path, _header(volume))
            self._acquisition = LinesWriter(self.path, ACQUISITION, {**grid, **self._settings})
        if grid != self._grid:
            raise ValueError(
                f"{self.path}: grid, scale or resolution of a volume differs from the first one's"
            )
        self._acquisition.append(describe_acquisition(volume))
        X_mm = volume.X_WP.GetAsMatrix4() * np.array([[1, 1, 1, 1e3]] * 3 + [[1] * 4])
        fields = {
            "ProbeToReferenceTransform": " ".join(repr(float(x)) for x in X_mm.ravel()),
            "ProbeToReferenceTransformStatus": "OK",
            "Timestamp": repr(volume.time),
        }
        self._volumes.append(volume.intensities, volume.time, fields)

    def close(self) -> None:
        """Give the files their final names; without any volume nothing is left."""
        if self._volumes is not None and self._acquisition is not None:
            self._acquisition.close()
            self._volumes.close()


def _header(volume: Volume) -> dict[str, str]:
    def vector(x: float, y: float, z: float) -> str:
        return f"({float(x)!r},{float(y)!r},{float(z)!r})"

    directions = [vector(*row) for row in np.diag(1e3 * volume.spacing)]
    return {
        "space": "left-posterior-superior",
        "space directions": " ".join([*directions, "none"]),
        "space origin": vector(*(1e3 * volume.origin)),
        "space units": '"mm" "mm" "mm"',
        "kinds": "domain domain domain list",
    }


class SweepWriter:
    """Writes sweeps as they come, as acquired: ``NAME.sweeps.seq.nrrd``.

    Its axes are sample, line, frame and list; they have spacings (in mm, deg, deg) and no
    directions in space, as a sector is no grid. The geometry is in the acquisition of the volumes.

    Parameters
    ----------
    path
        Of the recording of volumes that they belong to.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(path.name.removesuffix(SUFFIX) + ".sweeps" + SUFFIX)
        self._sweeps: SequenceWriter | None = None

    def append(self, sweep: Sweep) -> None:
        """Write a sweep."""
        geometry = sweep.geometry
        if self._sweeps is None:
            angles = np.degrees([geometry.line_pitch, geometry.frame_pitch])
            header = {
                "spacings": f"{1e3 * geometry.sample_pitch!r} {angles[0]} {angles[1]} nan",
                "kinds": "domain domain domain list",
            }
            self._sweeps = SequenceWriter(self.path, header)
        fields = {"SweepDirection": str(sweep.motion.direction)}
        self._sweeps.append(sweep.samples.T, sweep.motion.time, fields)

    def close(self) -> None:
        """Give the file its final name."""
        if self._sweeps is not None:
            self._sweeps.close()
