"""Leaf system that adds scripted faults to the wrist force sensor's samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
    OutputPort,
)

from sonoservo.systems.robot.wrist_force_sensor import Finite
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import (
    Bounded,
    PositiveTime,
    Time,
    one_of,
    require_not_negative,
    require_positive,
)

KINDS = ("nan", "frozen", "saturated", "jumping", "bias", "dead")
"""Kinds of faults of a force sensor."""


@dataclass(kw_only=True)
class SensorFault(Bounded):
    """One fault of the wrist force sensor during a run.

    Parameters
    ----------
    kind
        "nan": the samples are not numbers. "frozen": they repeat the last one before the fault.
        "saturated": the force along Y of P is ``value``, whatever acts. "jumping": ``value`` is
        added to it in every other sample. "bias": it is added to all samples. "dead": the samples
        are the sensor's noise about zero.
    start, duration
        Start time and duration, in s.
    value
        Force in N.
    """

    kind: Annotated[str, one_of(*KINDS)] = "nan"
    start: Time = 0.0
    duration: PositiveTime = 1.0
    value: Finite = 0.0

    def holds(self, time: float) -> bool:
        """Return True during the fault; ``time`` is in s."""
        return self.start <= time < self.start + self.duration


def faulty_sample(
    fault: SensorFault,
    sample: NDArray[np.float64],
    held: NDArray[np.float64],
    number: int,
    noise: float,
) -> NDArray[np.float64]:
    """Return a (6,) sample, in N m and N, as a fault distorts it."""
    if fault.kind == "nan":
        return np.full(6, np.nan)
    if fault.kind == "frozen":
        return held
    if fault.kind == "dead":
        return noise * np.random.default_rng(number).standard_normal(6)
    along = np.array([0.0, 0.0, 0.0, 0.0, fault.value, 0.0])
    if fault.kind == "saturated":
        return np.where(np.arange(6) == 4, along, sample)
    return sample + along * (fault.kind == "bias" or number % 2)


class SensorFaults(LeafSystem):
    """Distorts the samples of the wrist force sensor while faults hold.

    .. pydrake_system::

        name: SensorFaults
        input_ports:
        - wrist_force
        output_ports:
        - wrist_force

    Both are SpatialForces; see `WristForceSensor`.

    Parameters
    ----------
    faults
        Faults; if several hold at once, only the first of them counts.
    period
        Period of the sensor's samples, in s.
    noise
        Standard deviation of the noise of a dead sensor, in N and N m.
    """

    def __init__(self, *, faults: Sequence[SensorFault], period: float, noise: float) -> None:
        require_positive(period=period)
        require_not_negative(noise=noise)
        super().__init__()
        self._faults, self._period, self._noise = list(faults), period, noise
        declare_inputs(self, wrist_force=SpatialForce)
        self.DeclareDiscreteState(6)  # the last sample before a fault
        tickets = self.all_input_ports_ticket(), self.time_ticket(), self.xd_ticket()
        declare_output(self, "wrist_force", SpatialForce, self._calc_wrist_force, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0, self._update)

    def _fault(self, time: float) -> SensorFault | None:
        return next((each for each in self._faults if each.holds(time)), None)

    def _calc_wrist_force(self, context: Context, output: Value) -> None:
        force = evaluate(self, context, "wrist_force", SpatialForce)
        time = context.get_time()
        fault = self._fault(time)
        if fault is not None:
            held = context.get_discrete_state_vector().value()
            number = round(time / self._period)
            sample = faulty_sample(fault, force.get_coeffs(), held, number, self._noise)
            force = SpatialForce(sample)
        output.set_value(force)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self._fault(context.get_time()) is None:
            force = evaluate(self, context, "wrist_force", SpatialForce)
            discrete_state.set_value(force.get_coeffs())


def add_sensor_faults(
    builder: DiagramBuilder,
    wrist_force: OutputPort,
    faults: Sequence[SensorFault],
    *,
    period: float,
    noise: float,
) -> OutputPort:
    """Return the samples of a sensor as faults distort them; without faults, the port itself."""
    if not faults:
        return wrist_force
    leaf = builder.AddNamedSystem(
        "sensor_faults", SensorFaults(faults=faults, period=period, noise=noise)
    )
    builder.Connect(wrist_force, leaf.get_input_port())
    return leaf.get_output_port()
