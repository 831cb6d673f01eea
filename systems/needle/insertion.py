"""How a hand pushes a needle: where, along which arc, how deep at what time."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from sonoservo.systems.needle.needle import Needle
from sonoservo.systems.values import (
    require,
    require_not_negative,
    require_positive,
)

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
    entry
        Point in T where the needle, which must be outside, is put in from now on, in m; None leaves
        it where it is.
    """

    duration: float = 1.0
    speed: float = 0.0
    entry: list[float] | None = None

    def __post_init__(self) -> None:
        require_positive(duration=self.duration)
        if self.entry is not None:
            require(len(self.entry) == 3, "entry", self.entry, "three coordinates in m")
        require(abs(self.speed) <= 0.2, "speed", self.speed, "from -0.2 to 0.2 m/s")


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
        Direction of the bend about the needle's axis, in deg; 0 bends upwards.
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


class Insertion:
    """The insertion as a function of time.

    Parameters
    ----------
    parameters
        Of the needle and the hand.
    rng
        Draws this insertion's deviations, and the tremor's frequencies and phases.
    """

    def __init__(self, parameters: InsertionParameters, rng: np.random.Generator) -> None:
        self._parameters = parameters
        azimuth, dip, roll = np.deg2rad(
            [parameters.azimuth_deg, parameters.dip_deg, parameters.bend_roll_deg]
        )
        azimuth, dip = [azimuth, dip] + np.deg2rad(parameters.angle_spread_deg) * rng.uniform(
            -1, 1, 2
        )
        heading = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        up = np.array([0, 0, 1.0])
        offset = np.array(parameters.entry_spread) * rng.uniform(-1, 1, 3)
        self._direction = np.cos(dip) * heading - np.sin(dip) * up
        normal = np.sin(dip) * heading + np.cos(dip) * up
        self._bend = np.cos(roll) * normal + np.sin(roll) * np.cross(self._direction, normal)
        # A hand that takes `ramp` to change its speed pushes to the moving average of the depth
        # that sudden changes would give, which is the difference of its integral.
        speeds = [0.0, *(push.speed for push in parameters.pushes), 0.0]
        durations = [push.duration for push in parameters.pushes]
        times = parameters.start + np.concatenate([[0], np.cumsum(durations)])
        breaks = np.concatenate([[-1e9], times, [1e9]])
        speed = PPoly(np.array([speeds]), breaks)
        self._depth_integral = speed.antiderivative(2)
        self._end = float(times[-1]) + parameters.ramp
        self._entries = [(-np.inf, parameters.entry + offset)]
        for number, (push, start) in enumerate(zip(parameters.pushes, times, strict=False)):
            if push.entry is not None:
                depth = self._steady_depth(start)
                require(
                    depth <= 0,
                    f"pushes.{number}.entry",
                    push.entry,
                    f"left out: the needle is still {1e3 * depth:.1f} mm in the tissue",
                )
                self._entries.append((start, push.entry + offset))
        count = 8
        self._tremor_rate = 2 * np.pi * rng.uniform(*_TREMOR_BAND, count)
        self._tremor_phase = rng.uniform(0, 2 * np.pi, count)
        self._tremor_amplitude = parameters.tremor * np.sqrt(2 / count)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector in T along which the needle enters."""
        return self._direction

    @property
    def end(self) -> float:
        """When the hand comes to its last rest, in s."""
        return self._end

    def depth(self, time: float) -> float:
        """Inserted length along the shaft in m, tremor included; never below zero."""
        steady = self._steady_depth(time)
        if steady <= 0:
            return 0.0
        phases = self._tremor_rate * time + self._tremor_phase
        return max(0.0, steady + self._tremor_amplitude * float(np.sin(phases).sum()))

    def _steady_depth(self, time: float) -> float:
        """Inserted length in m without tremor; below zero it is how far the tip is outside."""
        ramp = self._parameters.ramp
        integral = self._depth_integral
        return float(integral(time) - integral(time - ramp)) / ramp

    def needle(self, time: float) -> Needle:
        """Return the part of the needle that is inside the tissue, in T."""
        length = self.depth(time)
        radius = OUTER_DIAMETER[self._parameters.gauge] / 2
        if length <= 0:
            return Needle(np.zeros((0, 3)), radius)
        bend_radius = self._parameters.bend_radius
        if bend_radius is None:
            s = np.array([0, length])
            along, aside = s, np.zeros(2)
        else:
            s = np.linspace(0, length, int(np.ceil(length / _POINT_SPACING)) + 1)
            along = bend_radius * np.sin(s / bend_radius)
            aside = bend_radius * (1 - np.cos(s / bend_radius))
        entry = [entry for start, entry in self._entries if start <= time][-1]
        shaft = entry + np.outer(along, self._direction) + np.outer(aside, self._bend)
        return Needle(shaft, radius)
