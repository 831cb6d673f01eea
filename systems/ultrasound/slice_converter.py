"""The leaf that converts sweeps of a single frame to slices."""

from functools import lru_cache

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry
from sonoservo.systems.ultrasound.slice_conversion import SliceConversion


class SliceConverter(LeafSystem):
    """Converts each sweep of a single frame to a slice; stateless, with a cached result.

    .. pydrake_system::

        name: SliceConverter
        input_ports:
        - sweep
        output_ports:
        - slice

    ``sweep`` holds a `Sweep`, or a `NotFound` that is passed on; ``slice`` holds an `ImageSlice`.

    Parameters
    ----------
    geometry
        Geometry of the sweeps.
    spacing
        Distance between the slice's pixels, in m.
    """

    def __init__(self, *, geometry: SweepGeometry, spacing: float) -> None:
        super().__init__()
        self.set_name("slice_converter")
        # The framework marks all state as changed at every event, but a sweep is immutable.
        self._conversion = lru_cache(maxsize=1)(SliceConversion(geometry, spacing))
        declare_inputs(self, sweep=(Sweep, NotFound))
        sweep = self.GetInputPort("sweep")
        declare_output(self, "slice", (ImageSlice, NotFound), self._calc_slice, {sweep.ticket()})

    def _calc_slice(self, context: Context, output: Value) -> None:
        sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
        output.set_value(sweep if isinstance(sweep, NotFound) else self._conversion(sweep))
