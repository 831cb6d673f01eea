"""How a hand pushes and turns a needle: where, along which path, how deep at what time."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly

from sonoservo.systems.needle.steered_path import cut_arcs, positions
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive

OUTER_DIAMETER = {
    14: 2.108e-3,
    16: 1.651e-3,
    17: 1.473e-3,
    18: 1.270e-3,
    20: 0.908e-3,
    21: 0.819e-3,
    22: 0.718e-3,
    25: 0.515e-3,
}
"""Outer diameter in m by gauge (ISO 9626)."""

_POINT_SPACING = 2e-3
"""Greatest distance in m between points on a bent shaft: off the arc by 3 um at R = 150 mm."""

_TURN_STEP = 1 / 64
"""Time in s between the angles of a bevel that is turned while it cuts: 1.4 deg at 90 deg/s."""

_REST = 1e-12
"""A step of the needle, in m, that is rounding alone."""

_TREMOR_BAND = (8.0, 12.0)
"""Frequencies of physiological hand tremor in Hz (Elble and Koller 1990)."""


@dataclass(kw_only=True)
class Push:
    """One phase of an insertion.

    Parameters
    ----------
    duration
        In s.
    speed
        In m/s; zero is a pause, below zero a withdrawal.
    turning_deg
        Rate at which the needle is turned about its axis, in deg/s: it steers a bevelled tip.
    entry
        Point in T where the needle, which must be outside, is put in from now on, in m; None leaves
        it where it is.
    azimuth_deg, dip_deg
        Direction of the insertion from now on, in deg, of a needle that must be outside; None
        leaves it as it is.
    """

    duration: float = 1.0
    speed: float = 0.0
    turning_deg: float = 0.0
    entry: list[float] | None = None
    azimuth_deg: float | None = None
    dip_deg: float | None = None

    def __post_init__(self) -> None:
        require_positive(duration=self.duration)
        require(abs(self.turning_deg) <= 720, "turning_deg", self.turning_deg, "up to 720 deg/s")
        dip_deg = self.dip_deg
        allowed = dip_deg is None or abs(dip_deg) <= 90
        require(allowed, "dip_deg", dip_deg, "from -90 to 90 deg")
        if self.entry is not None:
            require(len(self.entry) == 3, "entry", self.entry, "three coordinates in m")
        require(abs(self.speed) <= 0.2, "speed", self.speed, "from -0.2 to 0.2 m/s")

    @property
    def aim(self) -> dict[str, Any]:
        """What changes of where the needle is put in, by name."""
        if self.entry is None and self.azimuth_deg is None and self.dip_deg is None:
            return {}
        changed = {"entry": self.entry, "azimuth_deg": self.azimuth_deg, "dip_deg": self.dip_deg}
        return {name: value for name, value in changed.items() if value is not None}


@dataclass(kw_only=True)
class InsertionParameters:
    """A needle and the hand that pushes it.

    Parameters
    ----------
    gauge
        Of the needle; sets its diameter.
    entry
        Point in T where the needle enters the tissue, in m.
    azimuth_deg
        Direction of the insertion seen from above, from +X_T towards +Y_T, in deg.
    dip_deg
        Angle of the insertion below the horizontal, in deg.
    bend_radius
        Radius in m of the arc that a bevelled tip cuts; None for a straight needle.
    bend_roll_deg
        Direction of the bend about the needle's axis at the start, in deg; 0 bends upwards.
    start
        When the hand begins, in s.
    pushes
        The phases, one after the other; after the last the hand rests.
    ramp
        Time the hand takes to change speed, in s.
    tremor
        Root mean square of the hand's tremor along the needle, in m.
    entry_spread, angle_spread_deg
        How much one insertion differs from the next: greatest deviation, uniformly distributed, of
        each coordinate of the entry in m, and of azimuth and dip in deg.
    """

    gauge: int = 18
    entry: list[float] = field(default_factory=lambda: [-0.06, 0.0, -0.045])
    azimuth_deg: float = 0.0
    dip_deg: float = 0.0
    bend_radius: float | None = None
    bend_roll_deg: float = 0.0
    start: float = 1.0
    pushes: list[Push] = field(default_factory=list)
    ramp: float = 0.5
    tremor: float = 0.0
    entry_spread: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    angle_spread_deg: float = 0.0

    def __post_init__(self) -> None:
        allowed = ", ".join(str(gauge) for gauge in OUTER_DIAMETER)
        require(self.gauge in OUTER_DIAMETER, "gauge", self.gauge, f"one of {allowed}")
        require(len(self.entry) == 3, "entry", self.entry, "three coordinates in m")
        require(abs(self.dip_deg) <= 90, "dip_deg", self.dip_deg, "from -90 to 90 deg")
        if self.bend_radius is not None:
            require(self.bend_radius >= 0.05, "bend_radius", self.bend_radius, "at least 0.05 m")
        require_not_negative(
            start=self.start, tremor=self.tremor, angle_spread_deg=self.angle_spread_deg
        )
        require(
            len(self.entry_spread) == 3 and min(self.entry_spread) >= 0,
            "entry_spread",
            self.entry_spread,
            "three lengths in m of at least 0",
        )
        require_positive(ramp=self.ramp)


class Insertion(Immutable):
    """The insertion as a function of time. Later pushes do not change what it was before them.

    Parameters
    ----------
    parameters
        Of the needle and the hand.
    rng
        Draws this insertion's deviations, and the tremor's frequencies and phases.
    """

    def __init__(self, parameters: InsertionParameters, rng: np.random.Generator) -> None:
        self.parameters = parameters
        self._tilt = np.deg2rad(parameters.angle_spread_deg) * rng.uniform(-1, 1, 2)
        self._offset = np.array(parameters.entry_spread) * rng.uniform(-1, 1, 3)
        pushes = parameters.pushes
        times = parameters.start + np.cumsum([0.0, *(push.duration for push in pushes)])
        self._end = float(times[-1]) + parameters.ramp
        self._depth_integral = _twice_integrated(times, [push.speed for push in pushes])
        aim = _Aim(parameters.entry, parameters.azimuth_deg, parameters.dip_deg)
        self._aims = [(-np.inf, aim)]
        for number, (push, start) in enumerate(zip(pushes, times, strict=False)):
            for name, value in push.aim.items():
                depth = float(self._steady_depth(start))
                require(
                    depth <= 0,
                    f"pushes.{number}.{name}",
                    value,
                    f"left out: the needle is still {1e3 * depth:.1f} mm in the tissue",
                )
            if push.aim:
                aim = replace(aim, **push.aim)
                self._aims.append((start, aim))
        self._turn_integral: PPoly | None = None
        if parameters.bend_radius is not None and any(push.turning_deg for push in pushes):
            rates = np.deg2rad([push.turning_deg for push in pushes])
            self._turn_integral = _twice_integrated(times, rates)
            history = np.arange(parameters.start, self._end, _TURN_STEP)
            depths = self._steady_depth(history)
            # While the needle rests nothing is cut: only where it starts and stops matters.
            moves = np.abs(np.diff(depths)) > _REST
            kept = np.append(moves, False) | np.append(False, moves)
            self._history, self._depths = history[kept], depths[kept]
            self._turns = self._turn(self._history)
        count = 8
        self._tremor_rate = 2 * np.pi * rng.uniform(*_TREMOR_BAND, count)
        self._tremor_phase = rng.uniform(0, 2 * np.pi, count)
        self._tremor_amplitude = parameters.tremor * np.sqrt(2 / count)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector in T along which the needle enters at first."""
        return self._aims[0][1].axes(self._tilt)[0]

    @property
    def end(self) -> float:
        """When the hand comes to its last rest, in s."""
        return self._end

    @property
    def direction_deg(self) -> tuple[float, float]:
        """Azimuth and dip in deg that the last pushes ask for, this insertion's deviation aside."""
        _, aim = self._aims[-1]
        return aim.azimuth_deg, aim.dip_deg

    def is_outside(self, time: float) -> bool:
        """Whether the needle is out of the tissue, and may be put in anew."""
        return bool(self._steady_depth(time) <= 0)

    def depth(self, time: float) -> float:
        """Inserted length along the shaft in m, tremor included; never below zero."""
        steady = float(self._steady_depth(time))
        if steady <= 0:
            return 0.0
        phases = self._tremor_rate * time + self._tremor_phase
        return max(0.0, steady + self._tremor_amplitude * float(np.sin(phases).sum()))

    def needle(self, time: float) -> Needle:
        """Return the part of the needle that is inside the tissue, in T."""
        length = self.depth(time)
        radius = OUTER_DIAMETER[self.parameters.gauge] / 2
        aim = next(aim for start, aim in reversed(self._aims) if start <= time)
        entry, axes = aim.entry + self._offset, aim.axes(self._tilt)
        if length <= 0:
            tip = entry + min(float(self._steady_depth(time)), 0.0) * axes[0]
            return Needle(np.zeros((0, 3)), radius, np.array([tip, tip + axes[0]]))
        bend_radius = self.parameters.bend_radius
        if bend_radius is None:
            along = np.array([[0, 0, 0], [length, 0, 0]])
        else:
            s = np.linspace(0, length, int(np.ceil(length / _POINT_SPACING)) + 1)
            along = positions(*self._arcs(time, length), 1 / bend_radius, s)
        return Needle(entry + along @ axes, radius)

    def _arcs(self, time: float, length: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lengths in m and bevel's angles in rad of the arcs of the path, see `cut_arcs`."""
        if self._turn_integral is None:
            return np.array([length]), np.deg2rad([self.parameters.bend_roll_deg])
        past = np.searchsorted(self._history, time)
        depths = np.append(self._depths[:past], length)
        return cut_arcs(depths, np.append(self._turns[:past], self._turn(time)))

    def _steady_depth(self, time: ArrayLike) -> NDArray[np.float64]:
        """Inserted length in m without tremor; below zero it is how far the tip is outside."""
        return self._smoothed(self._depth_integral, time)

    def _turn(self, time: ArrayLike) -> NDArray[np.float64]:
        """Angle of the bevel in rad."""
        return np.deg2rad(self.parameters.bend_roll_deg) + self._smoothed(self._turn_integral, time)

    def _smoothed(self, integral: PPoly, time: ArrayLike) -> NDArray[np.float64]:
        # A hand that takes `ramp` to change its speed pushes to the moving average of the depth
        # that sudden changes would give, which is the difference of its integral.
        ramp = self.parameters.ramp
        return (integral(time) - integral(np.subtract(time, ramp))) / ramp


@dataclass(frozen=True)
class _Aim:
    """Where a needle is to be put in, see `InsertionParameters`."""

    entry: list[float]
    azimuth_deg: float
    dip_deg: float

    def axes(self, tilt: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, 3) rows along the needle, up from it and beside it, in T, tilted by (2,) rad."""
        azimuth, dip = np.deg2rad([self.azimuth_deg, self.dip_deg]) + tilt
        heading = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        up = np.array([0, 0, 1.0])
        direction = np.cos(dip) * heading - np.sin(dip) * up
        normal = np.sin(dip) * heading + np.cos(dip) * up
        return np.array([direction, normal, np.cross(direction, normal)])


def _twice_integrated(times: NDArray[np.float64], rates: ArrayLike) -> PPoly:
    """Second integral of a rate that is constant between times, and zero before and after them."""
    breaks = np.concatenate([[-1e9], times, [1e9]])
    return PPoly(np.concatenate([[0.0], rates, [0.0]])[np.newaxis], breaks).antiderivative(2)
