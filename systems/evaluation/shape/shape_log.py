"""The log of a run in which a needle's shape is predicted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

from sonoservo.systems.evaluation.log import Array, Column, Log, Row, columns, stack_rows


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeLog(Log):
    """Log with one row for each slice; positions are in the probe frame I of the first slice.

    Each field is an array of the file `log.npz`, under its own name. A missing value is NaN, or an
    empty text. The truth is the point at which the needle's axis would cross the slice if the
    tissue had not moved.
    """

    depth: Annotated[Array, Column("depth of the slice", "m", ("n",))]
    measured: Annotated[Array, Column("cross-section of the needle that was found", "m", ("n", 3))]
    true: Annotated[Array, Column("truth: the needle's axis in the slice", "m", ("n", 3))]
    correlation: Annotated[Array, Column("correlation with the template", "", ("n",))]
    reason: Annotated[Array, Column("why no cross-section was found", "", ("n",), "U")]
    tip: Annotated[
        Array, Column("predicted x and y of the tip at full depth after the slice", "m", ("n", 2))
    ]
    tip_covariance: Annotated[Array, Column("covariance of `tip`", "m^2", ("n", 2, 2))]
    image_s: Annotated[Array, Column("processor time of the tracker", "s", ("n",))]
    estimate_s: Annotated[Array, Column("processor time of the estimator", "s", ("n",))]

    @classmethod
    def from_rows(cls, rows: Sequence[Row], true_path: Callable[[Array], Array]) -> Self:
        """Make a log from rows that may lack values."""
        arrays: dict[str, Any] = {
            name: stack_rows(column, name, rows) for name, column in columns(cls).items()
        }
        return cls(**{**arrays, "true": true_path(arrays["depth"])})
