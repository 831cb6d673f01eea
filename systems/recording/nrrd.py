"""Volumes as files that 3D Slicer, ITK and others read."""

import io
from pathlib import Path

import nrrd
import numpy as np

from sonoservo.systems.recording.files import write_atomically
from sonoservo.systems.ultrasound.volume import Volume


def write_volume(path: str | Path, volume: Volume) -> Path:
    """Write a volume as NRRD, compressed with gzip, in mm, in the space LPS.

    The axes of the probe frame P become those of the patient that the format speaks of, as if the
    probe stood upright on the front of a patient who lies on the back: X of P (along the array) is
    L, to the patient's left; Y of P (depth) is P, to the back; Z of P (the sweep) is S, to the
    head. So a voxel lies at 1000 times its position in P.

    Parameters
    ----------
    path
        Where to; the suffix is usually ``.nrrd``.
    volume
        What to write.

    Returns
    -------
    The path.
    """
    buffer = io.BytesIO()
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag(1e3 * volume.spacing),
        "space origin": 1e3 * volume.origin,
        "space units": ["mm", "mm", "mm"],
        "kinds": ["domain", "domain", "domain"],
        "encoding": "gzip",
    }
    nrrd.write(buffer, volume.intensities, header, compression_level=1, index_order="F")
    return write_atomically(path, buffer.getvalue())
