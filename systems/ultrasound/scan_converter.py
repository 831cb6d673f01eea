"""Leaf system that converts sweeps to volumes."""

from dataclasses import dataclass, field
from functools import lru_cache

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid


@dataclass(kw_only=True)
class ScanConversionParameters:
    """Parameters of the scan conversion.

    Parameters
    ----------
    spacing
        Voxel size along X, Y and Z, in m.
    compensate_motion
        Whether a volume shows the tissue as a probe at rest would have seen it (see
        `ScanConversion`). Otherwise, the volume's `motion` holds the probe's pose for each frame.
    """

    spacing: list[float] = field(default_factory=lambda: [0.7e-3, 0.7e-3, 0.7e-3])
    compensate_motion: bool = False

    def __post_init__(self) -> None:
        require(
            len(self.spacing) == 3 and all(0.1e-3 <= s <= 5e-3 for s in self.spacing),
            "spacing",
            self.spacing,
            "three voxel sizes from 0.0001 to 0.005 m",
        )


class ScanConverter(LeafSystem):
    """Converts each sweep to a Cartesian volume; stateless, with a cached result.

    .. pydrake_system::

        name: ScanConverter
        input_ports:
        - sweep
        output_ports:
        - volume

    ``sweep`` holds a `Sweep`, or a `NotFound` that is passed on; ``volume`` holds a `Volume`.

    Parameters
    ----------
    geometry
        Geometry of the sweeps.
    parameters
        Parameters of the scan conversion.
    """

    def __init__(self, *, geometry: SweepGeometry, parameters: ScanConversionParameters) -> None:
        super().__init__()
        self.set_name("scan_converter")
        # The framework marks all state as changed at every event, but a sweep is immutable.
        self._converter = lru_cache(maxsize=1)(
            ScanConversion(
                geometry,
                make_grid(geometry, parameters.spacing),
                compensate_motion=parameters.compensate_motion,
            )
        )
        declare_inputs(self, sweep=(Sweep, NotFound))
        sweep = self.GetInputPort("sweep")
        declare_output(self, "volume", (Volume, NotFound), self._calc_volume, {sweep.ticket()})

    def _calc_volume(self, context: Context, output: Value) -> None:
        sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
        output.set_value(sweep if isinstance(sweep, NotFound) else self._converter(sweep))
