"""Sliders and buttons of the console, shared by its pages, and the leaf that reads them."""

import math
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from sonoservo.systems.signals.requirements import require_positive

_DEAD_ZONE = 0.15  # Dead zone of a gamepad's sticks, which never rest exactly at zero
_DEG = math.radians(1)

SPEEDS = (0.25, 0.5, 1.0, 2.0, 0.0)
"""Speeds that can be asked for, as multiples of real time; 0 for as fast as possible."""


@dataclass(frozen=True, kw_only=True)
class Control:
    """A slider, its keys, and the gamepad axis that also moves it.

    The values of a `port` are in the order of the controls; `unit` is a slider's 1 in SI units.
    `keys` lower and raise it by a step, which `ends` say in words, by default the label with a
    sign. `rate` is its speed at the axis's full deflection, in slider units per s, negative if up
    or left raises it.
    """

    name: str
    port: str
    label: str
    unit_label: str
    unit: float
    least: float
    most: float
    step: float
    start: float = 0.0
    keys: tuple[str, ...] = ()
    ends: tuple[str, ...] = ()
    axis: int | None = None
    rate: float = 0.0

    def within(self, value: Any, otherwise: float) -> float:
        """Return a value clamped to the range, or `otherwise` if it is no finite number."""
        number = finite_number(value)
        return otherwise if number is None else min(max(number, self.least), self.most)


def controller_controls(
    *, gain: float, force: float, min_force: float, max_force: float = 5.0
) -> list[Control]:
    """Return the sliders of the controller's gain in 1/s and contact force in N."""
    return [
        Control(name="gain", port="controller_target", label="servo gain", unit_label="1/s",
                unit=1.0, least=0, most=max(3.0, gain), step=0.1, start=gain),
        Control(name="force", port="controller_target", label="contact force", unit_label="N",
                unit=1.0, least=min_force, most=max(max_force, force), step=0.1, start=force),
    ]  # fmt: skip


def operator_controls(*, depth: float = 0.0, azimuth_deg: float, dip_deg: float) -> list[Control]:
    """Return the sliders of the needle, inserted by a depth in m at first, and the phantom."""
    return [
        Control(name="depth", port="needle_target", label="needle in", unit_label="mm", unit=1e-3,
                least=-5, most=max(100, 1e3 * depth + 60), step=1, start=1e3 * depth,
                keys=("KeyS", "KeyW"), ends=("needle out", "needle in"), axis=1, rate=-20),
        Control(name="turn", port="needle_target", label="turn", unit_label="deg", unit=_DEG,
                least=-360, most=360, step=5, keys=("KeyA", "KeyD"), axis=0, rate=90),
        Control(name="azimuth", port="needle_target", label="azimuth", unit_label="deg", unit=_DEG,
                least=azimuth_deg - 20, most=azimuth_deg + 20, step=1, start=azimuth_deg),
        Control(name="dip", port="needle_target", label="dip", unit_label="deg", unit=_DEG,
                least=max(dip_deg - 15, -90), most=min(dip_deg + 15, 90), step=1, start=dip_deg),
        Control(name="x", port="phantom_target", label="phantom x", unit_label="mm", unit=1e-3,
                least=-40, most=40, step=5, keys=("KeyJ", "KeyL"), axis=2, rate=40),
        Control(name="y", port="phantom_target", label="phantom y", unit_label="mm", unit=1e-3,
                least=-30, most=30, step=5, keys=("KeyK", "KeyI"), axis=3, rate=-40),
        Control(name="z", port="phantom_target", label="phantom z", unit_label="mm", unit=1e-3,
                least=-10, most=10, step=2, keys=("KeyH", "KeyY")),
        Control(name="yaw", port="phantom_target", label="phantom turn", unit_label="deg",
                unit=_DEG, least=-30, most=30, step=5, keys=("KeyU", "KeyO")),
    ]  # fmt: skip


def finite_number(value: Any) -> float | None:
    """Return what a page sent as a finite number; None if it is none, or too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def deflection(axis: Any) -> float:
    """Return a stick's deflection, from -1 to 1; 0 within its dead zone or if not finite."""
    value = finite_number(axis) or 0.0
    beyond = min(abs(value), 1.0) - _DEAD_ZONE
    return math.copysign(beyond / (1 - _DEAD_ZONE), value) if beyond > 0 else 0.0


class Controls:
    """Values of the sliders, buttons that were pressed and sticks that are deflected.

    All pages share them and set them on the site's thread; the run reads them on its own. Values
    are always finite and within their ranges. `changed` is called, on any thread, when what the
    pages show has changed.
    """

    def __init__(self, changed: Callable[[], None] = lambda: None) -> None:
        self._lock = threading.Lock()
        self._changed = changed
        self._controls: dict[str, Control] = {}
        self._values: dict[str, float] = {}
        self._buttons: tuple[str, ...] = ()
        self._pressed: set[str] = set()
        self._sticks: dict[object, list[float]] = {}
        self._has_speed = False
        self.speed = 1.0

    def offer(self, controls: Iterable[Control]) -> None:
        """Show sliders at their initial values, in place of earlier ones."""
        with self._lock:
            self._controls = {each.name: each for each in controls}
            self._values = {name: each.start for name, each in self._controls.items()}
        self._changed()

    def offer_buttons(self, *buttons: str, speed: float | None = None) -> None:
        """Show buttons by name, and the choice of a speed if there is one."""
        with self._lock:
            self._buttons = buttons
            self._has_speed = speed is not None
            self.speed = 1.0 if speed is None else speed
            self._pressed.clear()
        self._changed()

    def restart(self) -> None:
        """Return all sliders to their initial values."""
        self.offer(self._controls.values())

    @property
    def shown(self) -> tuple[list[Control], dict[str, float], tuple[str, ...]]:
        """Sliders, their values and the buttons."""
        with self._lock:
            return list(self._controls.values()), dict(self._values), self._buttons

    def value(self, name: str) -> float:
        """Return the value of a slider, in its own unit."""
        return self._values[name]

    def move(self, name: str, value: Any) -> None:
        """Set a slider; an unknown one is ignored, and so is a value that is no number."""
        with self._lock:
            control = self._controls.get(name)
            if control is None:
                return
            self._values[name] = control.within(value, self._values[name])
        self._changed()

    def press(self, button: str) -> None:
        """Press a button; several presses between two readings count once."""
        with self._lock:
            if button in self._buttons:
                self._pressed.add(button)

    def pressed(self) -> set[str]:
        """Return the buttons that were pressed since the last call."""
        with self._lock:
            pressed, self._pressed = self._pressed, set()
        return pressed

    def set_speed(self, speed: Any) -> None:
        """Ask for one of the `SPEEDS`; anything else is ignored."""
        if speed in SPEEDS:
            self.speed = float(speed)
            self._changed()

    def deflect(self, page: object, axes: Any) -> None:
        """Keep the axes of a page's gamepad; none if it has gone."""
        with self._lock:
            self._sticks.pop(page, None)
            if isinstance(axes, list | tuple) and axes:
                self._sticks[page] = [deflection(axis) for axis in axes[:16]]

    def step(self, seconds: float) -> None:
        """Let deflected sticks move their sliders for a time in s."""
        with self._lock:
            moves = [
                (control, control.rate * axes[control.axis] * seconds)
                for axes in self._sticks.values()
                for control in self._controls.values()
                if control.axis is not None and control.axis < len(axes)
            ]
            for control, move in moves:
                value = self._values[control.name]
                self._values[control.name] = control.within(value + move, value)
        if any(move for _, move in moves):
            self._changed()

    def description(self) -> Mapping[str, Any]:
        """Return what a page needs to draw sliders and buttons."""
        controls, _, buttons = self.shown
        return {
            "buttons": list(buttons),
            "speeds": self._has_speed,
            "sliders": [
                {
                    "name": each.name,
                    "label": each.label,
                    "unit": each.unit_label,
                    "least": each.least,
                    "most": each.most,
                    "step": each.step,
                    "keys": list(each.keys),
                    "ends": list(each.ends or (f"{each.label} −", f"{each.label} +")),
                }
                for each in controls
            ],
        }


class OperatorPanel(LeafSystem):
    """Reads the sliders of the console, which its pages, their keys and gamepads move.

    .. pydrake_system::

        name: OperatorPanel
        output_ports:
        - (one for each port that the controls name)

    The outputs are in SI units. Every control sets a target position, not a speed: everything comes
    to rest when the operator lets go, closes the page or loses the connection. Each run begins with
    the sliders at their initial values; `period` is the time between readings, in s.
    """

    def __init__(
        self, *, controls: Sequence[Control], inputs: Controls, period: float = 1 / 32
    ) -> None:
        require_positive(period=period)
        super().__init__()
        self._inputs, self._period = inputs, period
        inputs.offer(controls)
        self._names = [control.name for control in controls]
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
        self.DeclareInitializationPublishEvent(publish=lambda context: inputs.restart())
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._inputs.step(self._period)
        discrete_state.set_value([self._inputs.value(name) for name in self._names])
