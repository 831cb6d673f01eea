"""A system that stands for the clinician's hand."""

from typing import Protocol

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.needle import Needle


class NeedleMotion(Protocol):
    """An insertion as a function of time: `Insertion`, `BevelledInsertion`."""

    def needle(self, time: float) -> Needle:
        """Return the part of the needle that is inside the tissue, in T, at a time in s."""


class Hand(LeafSystem):
    """Pushes a needle into the tissue; a function of time alone.

    .. pydrake_system::

        name: Hand
        output_ports:
        - needle

    ``needle`` holds the inserted `Needle` in the tissue frame T, so that it moves with the tissue.

    Parameters
    ----------
    insertion
        Where and how the needle is pushed.
    """

    def __init__(self, *, insertion: NeedleMotion) -> None:
        super().__init__()
        self.set_name("hand")
        self._insertion = insertion
        empty: Needle = insertion.needle(-1e6)
        self.DeclareAbstractOutputPort(
            "needle",
            lambda: Value[object](empty),
            self._calc_needle,
            prerequisites_of_calc={self.time_ticket()},
        )

    def _calc_needle(self, context: Context, output: Value) -> None:
        output.set_value(self._insertion.needle(context.get_time()))
