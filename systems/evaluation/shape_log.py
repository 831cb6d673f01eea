"""What is kept of a run of shape prediction, and its file."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import Immutable

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShapeLog(Immutable):
    """One row for each slice. Positions are in the first slice's probe frame, in m.

    What is not there is NaN (a text: empty). Each field is an array of the file `log.npz`.

    Parameters
    ----------
    depth
        (n,) of the slice, in m.
    measured
        (n, 3) cross-section of the needle that was found.
    true
        (n, 3) truth: where the needle's axis passes the slice, had the tissue kept still.
    correlation
        (n,) with the template.
    reason
        (n,) why no cross-section was found.
    tip, tip_covariance
        (n, 2) predicted x and y of the tip at full depth after this slice, and (n, 2, 2) in m^2.
    image_s, estimate_s
        (n,) processor time of the tracker and of the estimator, in s.
    """

    depth: Floats
    measured: Floats
    true: Floats
    correlation: Floats
    reason: NDArray[np.str_]
    tip: Floats
    tip_covariance: Floats
    image_s: Floats
    estimate_s: Floats

    @classmethod
    def from_rows(
        cls, rows: Sequence[Mapping[str, Any]], true_path: Callable[[Floats], Floats]
    ) -> Self:
        """Make a log of rows that may lack what was not there."""

        def column(name: str, *shape: int) -> Floats:
            missing = np.full(shape, np.nan)
            values = [row.get(name, missing) for row in rows]
            return np.array(values, float).reshape(len(rows), *shape)

        depth = column("depth")
        return cls(
            depth=depth,
            measured=column("measured", 3),
            true=true_path(depth),
            correlation=column("correlation"),
            reason=np.array([row.get("reason", "") for row in rows], dtype=str),
            tip=column("tip", 2),
            tip_covariance=column("tip_covariance", 2, 2),
            image_s=column("image_s"),
            estimate_s=column("estimate_s"),
        )


def write_shape_log(path: str | Path, log: ShapeLog) -> Path:
    """Write a log to one `.npz` file, atomically."""
    buffer = io.BytesIO()
    arrays = {each.name: getattr(log, each.name) for each in fields(log)}
    np.savez_compressed(buffer, **arrays)
    return write_atomically(path, buffer.getvalue())
