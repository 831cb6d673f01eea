"""The log of a run in which a needle's shape is predicted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

from sonoservo.systems.evaluation.log import Array, Column, Log, Row, columns, stack_rows


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeLog(Log):
    """One row for each slice. Positions are in the first slice's probe frame I.

    Each field is an array of the file `log.npz`, under its own name. What is not there is NaN (a
    text: empty). Truth is where the needle's axis would pass the slice, had the tissue kept still.
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
        """Make a log of rows that may lack what was not there.

        Parameters
        ----------
        rows
            One for each slice, with the names of the arrays but `true`.
        true_path
            Returns the (n, 3) true path at (n,) depths.
        """
        arrays: dict[str, Any] = {
            name: stack_rows(column, name, rows) for name, column in columns(cls).items()
        }
        return cls(**{**arrays, "true": true_path(arrays["depth"])})
