"""Recordings made by other software than ours: pynrrd and SimpleITK, with their own rules."""

import nrrd
import numpy as np
import SimpleITK

STEPS = (0.3, 0.6, 1.1)
"""From voxel to voxel, in mm."""


def write_sequence_nrrd(
    path, arrays, *, list_first=False, encoding="gzip", times=None, steps=STEPS, **fields
):
    """As 3D Slicer does: arrays [i, j, k] in LPS mm."""
    stack = np.stack(arrays, axis=0 if list_first else -1)
    steps = np.diag(steps).tolist()
    none = [np.nan] * 3
    kinds = ["domain"] * 3
    labels = [""] * 3
    at = 0 if list_first else 3
    for entries, entry in ((steps, none), (kinds, "list"), (labels, "time")):
        entries.insert(at, entry)
    header = {
        "space": "left-posterior-superior",
        "space directions": np.array(steps),
        "space origin": [-20.0, 5.0, -30.0],
        "kinds": kinds,
        "labels": labels,
        "encoding": encoding,
        f"axis {at} index type": "numeric",
        f"axis {at} index values": " ".join(map(str, times or 0.3 * np.arange(len(arrays)))),
    }
    nrrd.write(str(path), stack, header | fields, compression_level=1)
    return path


def write_meta_image(path, arrays, fields=None, *, compressed=False, steps=STEPS):
    """Arrays [i, j, k]; several become a fourth axis, as PLUS stores them."""
    stack = np.stack([array.T for array in arrays]) if len(arrays) > 1 else arrays[0].T
    image = SimpleITK.GetImageFromArray(stack, isVector=False)
    image.SetSpacing([*steps] + [1.0] * (image.GetDimension() - 3))
    image.SetOrigin([-20.0, 5.0, -30.0] + [0.0] * (image.GetDimension() - 3))
    for key, value in (fields or {}).items():
        image.SetMetaData(key, value)
    SimpleITK.WriteImage(image, str(path), compressed)
    return path


def tracked(count, invalid=(), transform="ProbeToTracker"):
    """Fields of PLUS: every volume 0.25 s and 2 mm along the first axis after the one before."""
    fields = {}
    for k in range(count):
        row = f"0 -1 0 {2 * k} 1 0 0 5 0 0 1 -7 0 0 0 1"
        fields[f"Seq_Frame{k:04d}_{transform}Transform"] = row
        fields[f"Seq_Frame{k:04d}_{transform}TransformStatus"] = "INVALID" if k in invalid else "OK"
        fields[f"Seq_Frame{k:04d}_Timestamp"] = str(10 + 0.25 * k)
    return fields
