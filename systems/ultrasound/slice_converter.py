"""A system that turns sweeps of a single frame into slices."""

from functools import lru_cache

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry
from sonoservo.systems.ultrasound.slice_conversion import SliceConversion


class SliceConverter(LeafSystem):
    """Converts each sweep of a single frame to a Cartesian slice; stateless, the result is cached.

    .. pydrake_system::

        name: SliceConverter
        input_ports:
        - sweep
        output_ports:
        - slice

    ``sweep`` holds a `Sweep`, or a `NotFound` that is passed on; ``slice`` an `ImageSlice`.

    Parameters
    ----------
    geometry
        Of the sweeps to come.
    spacing
        Of the picture's elements, in m.
    """

    def __init__(self, *, geometry: SweepGeometry, spacing: float) -> None:
        super().__init__()
        self.set_name("slice_converter")
        # The framework marks all state as changed at every event; a sweep stays what it is.
        self._conversion = lru_cache(maxsize=1)(SliceConversion(geometry, spacing))
        sweep = self.DeclareAbstractInputPort("sweep", Value[object](NotFound("no sweep")))
        self.DeclareAbstractOutputPort(
            "slice",
            lambda: Value[object](NotFound("no slice")),
            self._calc_slice,
            prerequisites_of_calc={sweep.ticket()},
        )

    def _calc_slice(self, context: Context, output: Value) -> None:
        sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
        output.set_value(sweep if isinstance(sweep, NotFound) else self._conversion(sweep))
