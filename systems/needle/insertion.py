"""Insertion of a needle as a function of time, composed of its path and its motion."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.interpolate import PPoly

from sonoservo.systems.needle.beam_path import BeamPath
from sonoservo.systems.needle.insertion_parameters import (
    DEFAULT_ENTRY,
    OUTER_DIAMETER,
    FeedParameters,
    InsertionParameters,
    Push,
)
from sonoservo.systems.needle.steered_path import WANDER_STEP, SteeredPath, cut_arcs, draw_wander
from sonoservo.systems.signals.immutable import Immutable, seal
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]


_TRACK_STEP, _SHORTEST_TRACK = 0.05, 1e-3
"""Step in s of the search for the deepest point, and length in m below which no track shows."""

_SPACING = 2e-3
"""Largest distance in m between points on a bent shaft; 3 um off an arc of 150 mm radius."""

_FEED_SPACING = 0.5e-3  # the same distance behind a template; 0.1 um off an arc of 0.5 m radius

_SWING_DEPTH, _SWING_ANGLE, _SWING_RATE = 20e-3, 45.0, 30.0
"""Largest inserted length in m at which a straight needle is re-directed, about its entry, by at
most an angle in deg, and its rate in deg/s."""


class Insertion(Immutable):
    """Insertion as a function of time. Later pushes do not change its past.

    Parameters
    ----------
    parameters
        Needle, path and hand or template.
    rng
        Generator of this insertion's spreads, then of the tremor, the curvature's wander, and the
        errors of rotations and plane.

    Attributes
    ----------
    path
        Path of a bevelled needle as drawn, in coordinates along the aimed direction, up and beside;
        None if the needle is straight.

    Raises
    ------
    ValueError
        If a push aims a needle that is too deep for it, or the path turns back before the feed's
        depth.
    """

    def __init__(self, parameters: InsertionParameters, rng: np.random.Generator) -> None:
        start = parameters.start or 0.0
        entry = list(DEFAULT_ENTRY) if parameters.entry is None else parameters.entry
        parameters = replace(parameters, start=start, entry=entry, aim=None)
        self.parameters = parameters
        path = _draw_path(parameters, rng)
        if parameters.feed is None:
            self._tilt = np.deg2rad(parameters.angle_spread_deg) * rng.uniform(-1, 1, 2)
            play = rng.uniform(-1, 1, 3)
            self._motion: NeedleMotion = HandMotion(parameters, rng)
        else:
            self._tilt = np.zeros(2)
            play = -np.append(0.0, rng.uniform(-1, 1, 2))
            self._motion = Feed(parameters.feed, start)
        self._offset = np.array(parameters.entry_spread) * play
        self._aims: list[_Stage] = []
        self._times = np.arange(start, self._motion.end + _TRACK_STEP, _TRACK_STEP)
        self._depths = self._motion.steady_depth(self._times)
        self._add_aims()
        if path is not None and parameters.curvature_wander:
            times = np.linspace(start, self._motion.end, 200)
            length = 1.1 * float(self._motion.steady_depth(times).max()) + 0.01
            wander = draw_wander(length, parameters.curvature_wander, parameters.wander_length, rng)
            path = replace(path, wander=wander)
        if path is not None:
            path = self._with_errors(path, rng)
        self.path: SteeredPath | BeamPath | None = path
        if path is not None and parameters.mechanics == "beam":
            end = self._motion.depth(self._motion.end)
            self.path = BeamPath(path.radius, path.roll, path.angle, path.rotations, end)
        # Drawn last, so that everything else stays as it is.
        self._first_roll = np.deg2rad(parameters.roll_spread_deg) * float(rng.uniform(-1, 1))
        if parameters.feed is not None and self.path is not None:
            deepest = self._motion.depth(self._motion.end)
            reached = np.isfinite(self.path.length_at(deepest))
            allowed = "a depth that the path reaches"
            require(bool(reached), "feed.depth", parameters.feed.depth, allowed)

    def _with_errors(self, path: SteeredPath, rng: np.random.Generator) -> SteeredPath:
        """Return a path with errors of its rotations and a drift of its plane, if they spread."""
        p = self.parameters
        if p.rotation_depth_spread:
            errors = p.rotation_depth_spread * rng.uniform(-1, 1, len(path.rotations))
            path = replace(path, rotations=tuple(np.add(path.rotations, errors).tolist()))
        if p.rotation_angle_spread_deg:
            errors = np.deg2rad(p.rotation_angle_spread_deg) * rng.uniform(
                -1, 1, len(path.rotations)
            )
            path = replace(path, turn_errors=tuple(errors.tolist()))
        if p.bend_drift_spread_deg:
            drift = np.deg2rad(p.bend_drift_spread_deg) * rng.uniform(-1, 1) / 0.1
            steps = int(np.ceil((1.1 * self._motion.depth(self._motion.end) + 0.01) / WANDER_STEP))
            wander = path.wander if path.wander.size else np.ones(steps)
            path = replace(path, twist=float(drift), wander=wander)
        return path

    @property
    def entry(self) -> Floats:
        """(3,) point in T where the needle is first put in, in m."""
        return np.add(self._aims[0].aim.entry, self._offset)

    @property
    def direction(self) -> Floats:
        """(3,) unit vector in T along which the needle is first aimed."""
        return self._aims[0].aim.axes(self._tilt)[0]

    @property
    def end(self) -> float:
        """Time at which the needle comes to its final rest, in s."""
        return self._motion.end

    @property
    def direction_deg(self) -> tuple[float, float]:
        """Azimuth and dip in deg set by the last pushes, without this insertion's spread."""
        aim = self._aims[-1].aim
        return aim.azimuth_deg, aim.dip_deg

    @property
    def X_TI(self) -> RigidTransform:
        """Pose in T of frame I: origin at the first entry, Z along the aim, Y down, no spread."""
        aim = self._aims[0].aim
        along, up, beside = aim.axes(np.zeros(2))
        return RigidTransform(RotationMatrix(np.stack([beside, -up, along], axis=1)), aim.entry)

    def can_aim(self, time: float, azimuth_deg: float, dip_deg: float) -> bool:
        """Return True if the needle may be aimed in a direction, in deg, at a time in s."""
        now = self._aim_at(time)
        wanted = replace(now, azimuth_deg=azimuth_deg, dip_deg=dip_deg)
        return not self._obstacle(now, wanted, float(self._motion.steady_depth(time)))

    def depth(self, time: float) -> float:
        """Return the inserted depth in m: along the shaft, or behind a template the aim."""
        return self._motion.depth(time)

    def needle(self, time: float) -> Needle:
        """Return the part of the needle that is inside the tissue at a time in s, in T."""
        parameters, feed = self.parameters, self.parameters.feed
        radius = OUTER_DIAMETER[parameters.gauge] / 2
        aim = self._aim_at(time)
        entry, axes = aim.entry + self._offset, aim.axes(self._tilt)
        length = self.depth(time)
        if feed is not None and self.path is not None:
            length = self.path.length_at(length)
        if length <= 0 and feed is None:
            tip = entry + min(float(self._motion.steady_depth(time)), 0.0) * axes[0]
            track = self._track(time, 0.0, entry, axes[0])
            return Needle(np.zeros((0, 3)), radius, np.array([tip, tip + axes[0]]), track=track)
        track = None
        if self.path is None:
            track = self._track(time, length, entry, axes[0])
            first = np.array([1.0, 0.0, 0.0])
            along = np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]])
        else:
            along = self.path.positions(self._points(length), self._motion.cut(time, length))
            first = self.path.direction
        roll = self._roll(time, float(along[-1, 0]))
        if feed is not None:
            along = np.vstack([-feed.template * first, along])
        return Needle(entry + along @ axes, radius, roll=roll, track=track)

    def _track(self, time: float, length: float, entry: Floats, along: Floats) -> Floats | None:
        """Return the channel of a straight needle beyond its tip, since it was last aimed."""
        if self.path is not None or self.parameters.feed is not None:
            return None
        aimed = next(each.start for each in reversed(self._aims) if each.start <= time)
        first, last = self._times.searchsorted(aimed), self._times.searchsorted(time, "right")
        deepest = float(self._depths[first:last].max(initial=0.0))
        if deepest < length + _SHORTEST_TRACK:
            return None
        return entry + np.outer([length, deepest], along)

    def _roll(self, time: float, depth: float) -> float:
        """Return the roll of the bevel's face in rad, at a tip's depth along the aim in m."""
        turn = self._motion.turn(time)
        if self.path is None:
            return self._first_roll - turn
        rotations = sum(each < depth for each in self.path.rotations)
        return float(np.pi * (1 + rotations) - self.path.roll - turn)

    def _points(self, length: float) -> Floats:
        """Return distances in m along a bent shaft, from the entry to the tip."""
        if self.parameters.feed is None:
            return np.linspace(0, length, int(np.ceil(length / _SPACING)) + 1)
        # Behind a template the points stay in place from slice to slice.
        return np.append(np.arange(0, length, _FEED_SPACING), length)

    def _add_aims(self) -> None:
        """Add the aims of all pushes, in order of time."""
        parameters = self.parameters
        durations = [push.duration for push in parameters.pushes]
        starts = (parameters.start or 0.0) + np.cumsum([0.0, *durations])
        aim = _Aim(parameters.entry or [], parameters.azimuth_deg, parameters.dip_deg)
        self._aims.append(_Stage(-np.inf, -np.inf, aim, aim))
        for number, (push, start) in enumerate(zip(parameters.pushes, starts, strict=False)):
            if push.aim:
                self._aims.append(self._stage(number, push, float(start)))

    def _stage(self, number: int, push: Push, start: float) -> "_Stage":
        """Return the stage that a push with a new aim begins; the message names its field."""
        now, depth = self._aim_at(start), float(self._motion.steady_depth(start))
        wanted = replace(self._aims[-1].aim, **push.aim)
        obstacle = self._obstacle(now, wanted, depth)
        for name, value in push.aim.items():
            require(not obstacle, f"pushes.{number}.{name}", value, obstacle)
        angle = now.angle_to(wanted) if depth > 0 else 0.0
        return _Stage(start, start + angle / _SWING_RATE, now, wanted)

    def _aim_at(self, time: float) -> "_Aim":
        """Return the aim at a time in s."""
        return next(each for each in reversed(self._aims) if each.start <= time).at(time)

    def _obstacle(self, now: "_Aim", wanted: "_Aim", depth: float) -> str:
        """Return what keeps a needle at a depth in m from being aimed anew; empty if nothing."""
        if depth <= 0:
            return ""
        still = f"the needle is still {1e3 * depth:.1f} mm in the tissue"
        if wanted.entry != now.entry or self.parameters.bend_radius is not None:
            return f"left out: {still}; withdraw it first"
        if depth > _SWING_DEPTH:
            return f"left out: {still}; withdraw it to {1e3 * _SWING_DEPTH:.0f} mm first"
        if now.angle_to(wanted) > _SWING_ANGLE:
            return f"within {_SWING_ANGLE:g} deg of the present direction: {still}"
        return ""


@dataclass(frozen=True)
class _Aim:
    """Entry and direction at which a needle is aimed; see `InsertionParameters`."""

    entry: list[float]
    azimuth_deg: float
    dip_deg: float

    def axes(self, tilt: Floats) -> Floats:
        """Return (3, 3) rows along the needle, up and beside it, in T, tilted by (2,) rad."""
        return _axes(self.azimuth_deg, self.dip_deg, *tilt.tolist())

    def angle_to(self, other: "_Aim") -> float:
        """Return the angle in deg to another aim's direction."""
        d, e = (aim.axes(np.zeros(2))[0] for aim in (self, other))
        return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(d, e)), d @ e)))


@lru_cache(maxsize=16)
def _axes(azimuth_deg: float, dip_deg: float, turn: float, lean: float) -> Floats:
    """Return the axes of an aim turned in azimuth and dip, in rad; a hand rests at few of them."""
    azimuth, dip = np.deg2rad([azimuth_deg, dip_deg]) + np.array([turn, lean])
    heading = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    up = np.array([0, 0, 1.0])
    direction = np.cos(dip) * heading - np.sin(dip) * up
    normal = np.sin(dip) * heading + np.cos(dip) * up
    return seal(np.array([direction, normal, np.cross(direction, normal)]))


@dataclass(frozen=True)
class _Stage:
    """Aim from a time on; the needle turns to it from the aim before until another time, in s."""

    start: float
    until: float
    before: _Aim
    aim: _Aim

    def at(self, time: float) -> _Aim:
        """Return the aim at a time in s, not before the start."""
        if time >= self.until:
            return self.aim
        share = (time - self.start) / (self.until - self.start)
        share *= share * (3 - 2 * share)
        around = (self.aim.azimuth_deg - self.before.azimuth_deg + 180) % 360 - 180
        dip = self.aim.dip_deg - self.before.dip_deg
        return replace(
            self.aim,
            azimuth_deg=self.before.azimuth_deg + share * around,
            dip_deg=self.before.dip_deg + share * dip,
        )


def _draw_path(parameters: InsertionParameters, rng: np.random.Generator) -> SteeredPath | None:
    """Return the path without wander; quantities without a spread use no random number."""
    if parameters.bend_radius is None:
        return None

    def drawn(middle: float, spread: float) -> float:
        return middle + spread * float(rng.uniform(-1, 1)) if spread else middle

    radius = drawn(parameters.bend_radius, parameters.bend_radius_spread)
    angle_deg = drawn(0.0, parameters.bend_angle_spread_deg)
    roll_deg = drawn(parameters.bend_roll_deg, parameters.bend_roll_spread_deg)
    return SteeredPath(
        radius=radius,
        roll=float(np.deg2rad(roll_deg)),
        angle=float(np.deg2rad(angle_deg)),
        rotations=tuple(parameters.rotations),
    )


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
