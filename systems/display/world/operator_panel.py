"""The leaf that reads an operator's sliders, keys and gamepad in a Meshcat page."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from sonoservo.systems.signals.requirements import require_positive

_DEAD_ZONE = 0.15
"""Dead zone of a gamepad's sticks, which never rest exactly at zero."""

_DEG = math.radians(1)


@dataclass(frozen=True, kw_only=True)
class Control:
    """A slider, its keys, and the gamepad axis that also moves it.

    Parameters
    ----------
    port
        Output port of the value. The values of a port are in the order of the controls.
    label
        Label in the page, with the unit. The page shows about 14 letters.
    unit
        Value of 1 on the slider, in SI units.
    least, most, step
        Range and step of the slider.
    start
        Initial value of the slider.
    keys
        Keys that lower and raise the slider by a step, as the browser names them.
    axis, rate
        Axis of the gamepad, and the slider's speed at full deflection, in slider units per s. The
        rate is negative if up or left raises the value.
    """

    port: str
    label: str
    unit: float
    least: float
    most: float
    step: float
    start: float = 0.0
    keys: tuple[str, str] = ("", "")
    axis: int | None = None
    rate: float = 0.0


def operator_controls(
    *,
    depth: float = 0.0,
    azimuth_deg: float,
    dip_deg: float,
    gain: float,
    force: float,
    min_force: float,
) -> list[Control]:
    """Return the controls of the needle, the phantom and the controller.

    Parameters
    ----------
    depth
        Initial inserted length of the needle, in m.
    azimuth_deg, dip_deg
        Initial azimuth and dip of the needle, in deg.
    gain, force
        Initial gain and contact force of the controller, in 1/s and N.
    min_force
        Smallest contact force that can be set, in N.
    """
    return [
        Control(port="needle_target", label="depth (mm) S W", unit=1e-3, least=-5,
                most=max(100, 1e3 * depth + 60), step=1, start=1e3 * depth, keys=("KeyS", "KeyW"),
                axis=1, rate=-20),
        Control(port="needle_target", label="turn (deg) A D", unit=_DEG, least=-360,
                most=360, step=5, keys=("KeyA", "KeyD"), axis=0, rate=90),
        Control(port="needle_target", label="azimuth (deg)", unit=_DEG,
                least=azimuth_deg - 20, most=azimuth_deg + 20, step=1, start=azimuth_deg),
        Control(port="needle_target", label="dip (deg)", unit=_DEG,
                least=max(dip_deg - 15, -90), most=min(dip_deg + 15, 90), step=1, start=dip_deg),
        Control(port="phantom_target", label="phantom x (mm)", unit=1e-3, least=-40,
                most=40, step=5, keys=("KeyJ", "KeyL"), axis=2, rate=40),
        Control(port="phantom_target", label="phantom y (mm)", unit=1e-3, least=-30,
                most=30, step=5, keys=("KeyK", "KeyI"), axis=3, rate=-40),
        Control(port="phantom_target", label="phantom z (mm)", unit=1e-3, least=-10,
                most=10, step=2, keys=("KeyH", "KeyY")),
        Control(port="phantom_target", label="phantom (deg)", unit=_DEG, least=-30,
                most=30, step=5, keys=("KeyU", "KeyO")),
        Control(port="controller_target", label="lambda (1/s)", unit=1.0, least=0,
                most=max(3.0, gain), step=0.1, start=gain),
        Control(port="controller_target", label="force (N)", unit=1.0, least=min_force,
                most=max(5.0, force), step=0.1, start=force),
    ]  # fmt: skip


class OperatorPanel(LeafSystem):
    """Reads sliders, keys and a gamepad in the page of a Meshcat.

    .. pydrake_system::

        name: OperatorPanel
        output_ports:
        - needle_target
        - phantom_target
        - controller_target

    There is an output port, in SI units, for each port that the controls name. Every control sets a
    target position, not a speed: everything comes to rest when the operator lets go, closes the
    page or loses the connection. All pages share the sliders. The outputs are always finite and
    within the sliders' ranges, whatever a page sends. Each run begins with the sliders at their
    initial values.

    Parameters
    ----------
    meshcat
        Meshcat whose page shows the controls.
    controls
        Controls, in the order in which they are shown.
    period
        Time between readings, in s.
    """

    def __init__(
        self, *, meshcat: Meshcat, controls: Sequence[Control], period: float = 1 / 32
    ) -> None:
        require_positive(period=period)
        super().__init__()
        self._meshcat, self._controls, self._period = meshcat, list(controls), period
        self._shown: list[float] = []
        self._stale: tuple[float, ...] = ()
        self._pages = 0
        self._units = np.array([control.unit for control in controls])
        self.DeclareDiscreteState([control.start for control in controls])
        for port in dict.fromkeys(control.port for control in controls):
            numbers = [n for n, control in enumerate(controls) if control.port == port]

            def calc(context: Context, output: BasicVector, n: list[int] = numbers) -> None:
                values = context.get_discrete_state_vector().value()
                output.SetFromVector((values * self._units)[n])

            self.DeclareVectorOutputPort(
                port, len(numbers), calc, prerequisites_of_calc={self.xd_ticket()}
            )
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _start(self) -> None:
        for control in self._controls:
            if control.label in self._meshcat.GetSliderNames():
                self._meshcat.SetSliderValue(control.label, control.start)
            else:
                self._meshcat.AddSlider(
                    control.label, control.least, control.most, control.step, control.start,
                    *control.keys,
                )  # fmt: skip
        self._shown = self._read()

    def _read(self) -> list[float]:
        return [self._meshcat.GetSliderValue(control.label) for control in self._controls]

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        before = context.get_discrete_state_vector().value().tolist()
        read, sticks = self._read(), self._sticks()
        wanted = []
        for number, control in enumerate(self._controls):
            value = before[number]
            # A slider stays where the last reading left it unless someone has moved it since.
            moved = read[number] != self._shown[number]
            if moved:
                value = within(control, read[number], value)
            if control.axis is not None and control.axis < len(sticks):
                step = self._period * control.rate * sticks[control.axis]
                value = within(control, value + step, value)
            if value != read[number] and (moved or value != before[number]):
                self._meshcat.SetSliderValue(control.label, value)
                read[number] = self._meshcat.GetSliderValue(control.label)
            wanted.append(value)
        self._shown = read
        discrete_state.set_value(wanted)

    def _sticks(self) -> list[float]:
        """Return the axes of the gamepad, each from -1 to 1; none while no page reports it."""
        pages, axes = (
            self._meshcat.GetNumActiveConnections(),
            tuple(self._meshcat.GetGamepad().axes),
        )
        # A closed page may have left a stick pushed to the side.
        if pages < self._pages:
            self._stale = axes
        self._pages = pages
        if axes != self._stale:
            self._stale = ()
        return [] if axes == self._stale else [deflection(axis) for axis in axes]


def within(control: Control, value: float, otherwise: float) -> float:
    """Return a value clamped to the range of a control, or `otherwise` if it is not finite."""
    if not math.isfinite(value):
        return otherwise
    return min(max(value, control.least), control.most)


def deflection(axis: float) -> float:
    """Return a stick's deflection, from -1 to 1; 0 within its dead zone or if not finite."""
    if not math.isfinite(axis) or abs(axis) <= _DEAD_ZONE:
        return 0.0
    return math.copysign((min(abs(axis), 1.0) - _DEAD_ZONE) / (1 - _DEAD_ZONE), axis)
