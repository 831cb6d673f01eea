"""Depth and turning of a needle over time, driven by a hand or fed through a template."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly

from sonoservo.systems.needle.insertion_parameters import FeedParameters, InsertionParameters
from sonoservo.systems.needle.steered_path import cut_arcs

Floats = NDArray[np.float64]

_TURN_STEP = 1 / 64
"""Time in s between the sampled angles of a turning bevel, which are 1.4 deg apart at 90 deg/s."""

_REST = 1e-12  # largest step of the needle in m that counts as rest, as rounding can cause it
_TREMOR_BAND = (8.0, 12.0)  # frequencies of physiological hand tremor in Hz (Elble and Koller 1990)


class NeedleMotion(Protocol):
    """Motion of a needle along its path."""

    @property
    def end(self) -> float:
        """Time at which the needle comes to its final rest, in s."""

    def steady_depth(self, time: ArrayLike) -> Floats:
        """Return the depth in m without tremor; it is negative while the tip is outside."""

    def depth(self, time: float) -> float:
        """Return the depth in m including tremor, never below zero."""

    def cut(self, time: float, length: float) -> tuple[Floats, Floats] | None:
        """Return the arcs (`cut_arcs`) until a time, to a present length in m, if turned."""

    def turn(self, time: float) -> float:
        """Return the angle by which the needle has been turned about its axis, in rad."""


class Feed:
    """Feed at constant speed from a time in s on, with depths along the aimed direction."""

    def __init__(self, parameters: FeedParameters, start: float) -> None:
        self._parameters = parameters
        self._start = start

    @property
    def end(self) -> float:
        """Time at which the needle comes to its final rest, in s."""
        return self._start + self._parameters.depth / self._parameters.speed

    def steady_depth(self, time: ArrayLike) -> Floats:
        """Return the depth in m."""
        pushed = self._parameters.speed * np.maximum(np.subtract(time, self._start), 0.0)
        return np.minimum(pushed, self._parameters.depth) + self._parameters.lead

    def depth(self, time: float) -> float:
        """Return the depth in m."""
        return float(self.steady_depth(time))

    def cut(self, time: float, length: float) -> None:
        """Return None, as a template turns the needle only at the path's rotations."""

    def turn(self, time: float) -> float:
        """Return 0, as a template turns the needle only at the path's rotations."""
        return 0.0


class HandMotion:
    """Motion by a hand's pushes, with depths that are lengths of the inserted shaft."""

    def __init__(self, parameters: InsertionParameters, rng: np.random.Generator) -> None:
        pushes, start = parameters.pushes, parameters.start or 0.0
        times = start + np.cumsum([0.0, *(push.duration for push in pushes)])
        self._ramp = parameters.ramp
        self._end = float(times[-1]) + parameters.ramp
        self._initial_depth = parameters.initial_depth or 0.0
        self._depth_integral = _twice_integrated(times, [push.speed for push in pushes])
        self._turn_integral: PPoly | None = None
        self._cuts = parameters.bend_radius is not None
        if any(push.turning_deg for push in pushes):
            rates = np.deg2rad([push.turning_deg for push in pushes])
            self._turn_integral = _twice_integrated(times, rates)
        if self._turn_integral is not None and self._cuts:
            history = np.arange(start, self._end, _TURN_STEP)
            depths = self.steady_depth(history)
            # A resting needle cuts nothing, so only the times at which it starts and stops matter.
            moves = np.abs(np.diff(depths)) > _REST
            kept = np.append(moves, False) | np.append(False, moves)
            self._history, self._depths = history[kept], depths[kept]
            self._turns = self._smoothed(self._turn_integral, self._history)
            if self._initial_depth:
                # What is in the tissue from the beginning was cut before the needle was turned.
                self._history = np.append([-np.inf, start], self._history)
                self._depths = np.append([0.0, self._initial_depth], self._depths)
                self._turns = np.append([0.0, 0.0], self._turns)
        count = 8
        self._tremor_rate = 2 * np.pi * rng.uniform(*_TREMOR_BAND, count)
        self._tremor_phase = rng.uniform(0, 2 * np.pi, count)
        self._tremor_amplitude = parameters.tremor * np.sqrt(2 / count)

    @property
    def end(self) -> float:
        """Time at which the needle comes to its final rest, in s."""
        return self._end

    def steady_depth(self, time: ArrayLike) -> Floats:
        """Return the depth in m without tremor; it is negative while the tip is outside."""
        return self._initial_depth + self._smoothed(self._depth_integral, time)

    def depth(self, time: float) -> float:
        """Return the depth in m including tremor, never below zero."""
        steady = float(self.steady_depth(time))
        if steady <= 0:
            return 0.0
        phases = self._tremor_rate * time + self._tremor_phase
        return max(0.0, steady + self._tremor_amplitude * float(np.sin(phases).sum()))

    def cut(self, time: float, length: float) -> tuple[Floats, Floats] | None:
        """Return the arcs cut until a time, down to a present length in m; None without turning."""
        if self._turn_integral is None or not self._cuts:
            return None
        past = np.searchsorted(self._history, time)
        now = self._smoothed(self._turn_integral, time)
        return cut_arcs(np.append(self._depths[:past], length), np.append(self._turns[:past], now))

    def turn(self, time: float) -> float:
        """Return the angle by which the needle has been turned about its axis, in rad."""
        if self._turn_integral is None:
            return 0.0
        return float(self._smoothed(self._turn_integral, time))

    def _smoothed(self, integral: PPoly, time: ArrayLike) -> Floats:
        # A hand takes the time `ramp` to change its speed. The depth is therefore the moving
        # average of the depth with sudden changes, which is a difference of its integral.
        now, before = integral([time, np.subtract(time, self._ramp)])
        smoothed: Floats = (now - before) / self._ramp
        return smoothed


def _twice_integrated(times: Floats, rates: ArrayLike) -> PPoly:
    """Return the second integral of a rate that is constant between times and zero outside them."""
    breaks = np.concatenate([[-1e9], times, [1e9]])
    return PPoly(np.concatenate([[0.0], rates, [0.0]])[np.newaxis], breaks).antiderivative(2)
