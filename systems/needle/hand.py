"""Leaf system that pushes a needle, as a clinician's hand or a template does."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_output


class Hand(LeafSystem):
    """Pushes a needle into the tissue, as a function of time alone.

    .. pydrake_system::

        name: Hand
        output_ports:
        - needle

    ``needle`` is the inserted `Needle` in the tissue frame T. It moves with the tissue.

    Parameters
    ----------
    insertion
        Path and motion of the needle.
    """

    def __init__(self, *, insertion: Insertion) -> None:
        super().__init__()
        self.set_name("hand")
        self._insertion = insertion
        declare_output(self, "needle", Needle, self._calc_needle, {self.time_ticket()})

    def _calc_needle(self, context: Context, output: Value) -> None:
        output.set_value(self._insertion.needle(context.get_time()))
