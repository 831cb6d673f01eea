"""Writers of recordings: a sequence for 3D Slicer, and the acquisition of its volumes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sonoservo.systems.files.writing import Closing
from sonoservo.systems.recording.sequence_writer import SUFFIX, SequenceWriter
from sonoservo.systems.recording.side_files import (
    ACQUISITION,
    LinesWriter,
    describe_acquisition,
    describe_grid,
)
from sonoservo.systems.recording.valid_frames import matrix_text
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume


class RecordingWriter(Closing):
    """Writes volumes one by one to ``NAME.seq.nrrd`` and ``NAME.acquisition.jsonl``.

    The voxels have the coordinates that `write_volume` gives them. A volume's time is its index
    value, and X_WP is its field ``ProbeToReferenceTransform`` (in mm), as PLUS would write it. The
    acquisition file holds the same values bit for bit, and the time and pose of each frame. After
    an interruption, the volumes written so far stay readable (`SequenceWriter`). `close` gives the
    files their final names.

    Parameters
    ----------
    path
        Path of the recording, which must end in ``.seq.nrrd``.
    settings
        Further settings that a tracker needs; they go into the acquisition's first line.

    Raises
    ------
    ValueError
        If the path has another suffix.
    """

    def __init__(self, path: str | Path, settings: Mapping[str, Any] | None = None) -> None:
        self.path = Path(path)
        if not self.path.name.endswith(SUFFIX):
            raise ValueError(f"record: {self.path} is not allowed; it must end in {SUFFIX}")
        self._settings = dict(settings or {})
        self._volumes: SequenceWriter | None = None
        self._acquisition: LinesWriter | None = None
        self._grid: dict[str, Any] = {}

    def append(self, volume: Volume) -> None:
        """Write a volume, with the grid, scale of grey levels and point spread of the first one."""
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
            "ProbeToReferenceTransform": matrix_text(X_mm),
            "ProbeToReferenceTransformStatus": "OK",
            "Timestamp": repr(volume.time),
        }
        self._volumes.append(volume.intensities, volume.time, fields)

    def close(self) -> None:
        """Give the files their final names; without any volume, no file is left."""
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
    """Writes the sweeps of a recording, by the path of its volumes, to ``NAME.sweeps.seq.nrrd``."""

    def __init__(self, path: Path) -> None:
        self.path = path.with_name(path.name.removesuffix(SUFFIX) + ".sweeps" + SUFFIX)
        self._sweeps: SequenceWriter | None = None

    def append(self, sweep: Sweep) -> None:
        """Write a sweep."""
        geometry = sweep.geometry
        if self._sweeps is None:
            angles = np.degrees([geometry.line_pitch, geometry.frame_pitch])
            # Spacings, but no directions in space: a sector is no grid.
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
