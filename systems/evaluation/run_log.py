"""What is kept of a run, and its file."""

import io
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import Immutable

FORMAT = 2
"""Version of the file, its array `format`."""

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """What an array of a log holds.

    Parameters
    ----------
    what
        In words.
    unit
        Empty where there is none.
    shape
        Extents: a number, or the letter of an extent that all arrays share.
    dtype
        "f8", "?" or "U" for texts.
    """

    what: str
    unit: str
    shape: tuple[int | str, ...]
    dtype: str = "f8"


@dataclass(frozen=True, eq=False, kw_only=True)
class RunLog(Immutable):
    """What is kept of a run: n samples at a fixed period, and v volumes.

    Each field is an array of the file `log.npz`, under its own name. What was not connected, or is
    not there at that time, is NaN (a text: empty). Everything is in SI units and in the world frame
    W unless it says otherwise. Truth is what the simulator knows and what no tracker or controller
    reads.
    """

    time: Annotated[Array, Column("time of the sample", "s", ("n",))]
    X_WP: Annotated[Array, Column("pose of the probe", "m", ("n", 4, 4))]
    X_WT: Annotated[Array, Column("pose of the phantom", "m", ("n", 4, 4))]
    needle_tip: Annotated[
        Array, Column("truth: the tip; NaN while it is outside the tissue", "m", ("n", 3))
    ]
    needle_entry: Annotated[
        Array, Column("truth: where the needle enters the tissue", "m", ("n", 3))
    ]
    needle_points: Annotated[
        Array, Column("truth: nine points evenly along it, entry to tip", "m", ("n", 9, 3))
    ]
    inserted_length: Annotated[Array, Column("truth: length inside the tissue", "m", ("n",))]
    visible_length: Annotated[Array, Column("truth: length inside the swept sector", "m", ("n",))]
    estimate_mode: Annotated[Array, Column("what the tracker does", "", ("n",), "U")]
    estimate_time: Annotated[Array, Column("time for which the estimate holds", "s", ("n",))]
    estimate_tip: Annotated[Array, Column("estimated tip", "m", ("n", 3))]
    estimate_entry: Annotated[Array, Column("estimated entry", "m", ("n", 3))]
    estimate_velocity: Annotated[Array, Column("estimated velocity of the tip", "m/s", ("n", 3))]
    joint_state: Annotated[
        Array, Column("positions, then velocities, of the arm's joints", "rad", ("n", "2j"))
    ]
    contact_force: Annotated[Array, Column("truth: force between probe and phantom", "N", ("n",))]
    wrist_force: Annotated[
        Array, Column("torque, then force, that the wrist sensor measures", "N m, N", ("n", 6))
    ]
    planar_velocity: Annotated[
        Array, Column("commanded v_x, v_z, omega_y of the probe in P", "m/s", ("n", 3))
    ]

    volume_time: Annotated[Array, Column("middle of the volume's acquisition", "s", ("v",))]
    volume_seen: Annotated[Array, Column("when the log saw the estimate made with it", "s", ("v",))]
    volume_detected: Annotated[Array, Column("whether an insertion was detected", "", ("v",), "?")]
    volume_detection_reason: Annotated[Array, Column("why none was", "", ("v",), "U")]
    volume_measured_time: Annotated[Array, Column("time of the measured tip", "s", ("v",))]
    volume_measured_tip: Annotated[Array, Column("tip that the volume shows", "m", ("v", 3))]
    volume_measured_entry: Annotated[Array, Column("entry that the volume shows", "m", ("v", 3))]
    volume_inlier_count: Annotated[Array, Column("voxels that support it", "", ("v",))]
    volume_inlier_ratio: Annotated[Array, Column("their share of all candidates", "", ("v",))]
    volume_measurement_reason: Annotated[Array, Column("why it shows none", "", ("v",), "U")]
    volume_estimate_mode: Annotated[Array, Column("mode after this volume", "", ("v",), "U")]
    volume_estimate_time: Annotated[Array, Column("time of the estimate after it", "s", ("v",))]
    volume_estimate_tip: Annotated[Array, Column("estimated tip after it", "m", ("v", 3))]
    volume_estimate_entry: Annotated[Array, Column("estimated entry after it", "m", ("v", 3))]
    volume_estimate_points: Annotated[
        Array, Column("estimated entry, middle and tip of the curve after it", "m", ("v", 3, 3))
    ]

    compute: Mapping[str, Array] = field(default_factory=dict)
    """Computing time per volume in s, by what was computed; in the file as `compute_<name>`."""

    def __post_init__(self) -> None:
        extents: dict[int | str, int] = {}
        for name, column in columns().items():
            array = np.asarray(getattr(self, name))
            if column.dtype != "U":
                array = array.astype(column.dtype, copy=False)
            array = array.view()
            wanted = column.shape
            fits = array.ndim == len(wanted) and all(
                got == (want if isinstance(want, int) else extents.setdefault(want, got))
                for got, want in zip(array.shape, wanted, strict=True)
            )
            if not fits:
                raise ValueError(f"{name} has shape {array.shape}; {_text(wanted)} is wanted")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def estimate_direction(self) -> Array:
        """(n, 3) unit vectors from the estimated entry to the estimated tip, in W."""
        return unit(self.estimate_tip - self.estimate_entry)


def unit(vectors: Array) -> Array:
    """Return (m, 3) vectors divided by their lengths; NaN where there is none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, np.nan)


@cache
def columns() -> Mapping[str, Column]:
    """Return what each array of a log holds, by the array's name."""
    hints = get_type_hints(RunLog, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if name != "compute"}


def column_table() -> str:
    """Return the arrays of the file as a Markdown table: name, shape, unit, what it is."""
    rows = [
        f"| `{name}` | {_text(column.shape)} | {column.unit} | {column.what} |"
        for name, column in columns().items()
    ]
    return "\n".join(["| array | shape | unit | what |", "|---|---|---|---|", *rows])


def _text(shape: tuple[int | str, ...]) -> str:
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


def write_log(path: str | Path, log: RunLog) -> Path:
    """Write a run to one `.npz` file, atomically."""
    arrays = {name: getattr(log, name) for name in columns()}
    arrays |= {f"compute_{name}": array for name, array in log.compute.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, format=np.array(FORMAT), **arrays)
    return write_atomically(path, buffer.getvalue())


def read_log(path: str | Path) -> RunLog:
    """Read a run back from its `.npz` file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a whole log, or one of another format.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no log at {path}")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (
        OSError,
        EOFError,
        ValueError,
        TypeError,
        AttributeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"{path} is not a log, or only a part of one: {error}") from error
    version = arrays.pop("format", None)
    if version is None or version.shape or int(version) != FORMAT:
        raise ValueError(f"{path} has format {version}; this program reads format {FORMAT}")
    if missing := sorted(columns().keys() - arrays.keys()):
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    compute = {
        name.removeprefix("compute_"): array
        for name, array in arrays.items()
        if name.startswith("compute_")
    }
    return RunLog(**{name: arrays[name] for name in columns()}, compute=compute)
