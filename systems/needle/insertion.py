"""Insertion of a needle as a function of time, composed of its path and its motion."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER, InsertionParameters
from sonoservo.systems.needle.needle_motion import Feed, HandMotion, NeedleMotion
from sonoservo.systems.needle.steered_path import SteeredPath, draw_wander
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]

_SPACING = 2e-3
"""Largest distance in m between points on a bent shaft; 3 um off an arc of 150 mm radius."""

_FEED_SPACING = 0.5e-3
"""The same distance behind a template; 0.1 um off an arc of 0.5 m radius."""


class Insertion(Immutable):
    """Insertion as a function of time. Later pushes do not change its past.

    Parameters
    ----------
    parameters
        Needle, path and hand or template.
    rng
        Generator of this insertion's spreads, then of the tremor, then of the curvature's wander.

    Attributes
    ----------
    path
        Path of a bevelled needle as drawn, in coordinates along the aimed direction, up and beside;
        None if the needle is straight.

    Raises
    ------
    ValueError
        If a push aims a needle that is not outside, or the path turns back before the feed's depth.
    """

    def __init__(self, parameters: InsertionParameters, rng: np.random.Generator) -> None:
        self.parameters = parameters
        path = _draw_path(parameters, rng)
        if parameters.feed is None:
            self._tilt = np.deg2rad(parameters.angle_spread_deg) * rng.uniform(-1, 1, 2)
            play = rng.uniform(-1, 1, 3)
            self._motion: NeedleMotion = HandMotion(parameters, rng)
        else:
            self._tilt = np.zeros(2)
            play = -np.append(0.0, rng.uniform(-1, 1, 2))
            self._motion = Feed(parameters.feed, parameters.start)
        self._offset = np.array(parameters.entry_spread) * play
        self._aims = self._aims_of_pushes()
        if path is not None and parameters.curvature_wander:
            times = np.linspace(parameters.start, self._motion.end, 200)
            length = 1.1 * float(self._motion.steady_depth(times).max()) + 0.01
            wander = draw_wander(length, parameters.curvature_wander, parameters.wander_length, rng)
            path = replace(path, wander=wander)
        self.path = path
        if parameters.feed is not None and path is not None:
            deepest = self._motion.depth(self._motion.end)
            reached = np.isfinite(path.length_at(deepest))
            allowed = "a depth that the path reaches"
            require(bool(reached), "feed.depth", parameters.feed.depth, allowed)

    @property
    def entry(self) -> Floats:
        """(3,) point in T where the needle is first put in, in m."""
        return np.add(self._aims[0][1].entry, self._offset)

    @property
    def direction(self) -> Floats:
        """(3,) unit vector in T along which the needle is first aimed."""
        return self._aims[0][1].axes(self._tilt)[0]

    @property
    def end(self) -> float:
        """Time at which the needle comes to its final rest, in s."""
        return self._motion.end

    @property
    def direction_deg(self) -> tuple[float, float]:
        """Azimuth and dip in deg set by the last pushes, without this insertion's spread."""
        _, aim = self._aims[-1]
        return aim.azimuth_deg, aim.dip_deg

    @property
    def X_TI(self) -> RigidTransform:
        """Pose in T of frame I: origin at the first entry, Z along the aim, Y down, no spread."""
        _, aim = self._aims[0]
        along, up, beside = aim.axes(np.zeros(2))
        return RigidTransform(RotationMatrix(np.stack([beside, -up, along], axis=1)), aim.entry)

    def is_outside(self, time: float) -> bool:
        """Return True if the needle is outside the tissue at a time in s, and may be aimed anew."""
        return bool(self._motion.steady_depth(time) <= 0)

    def depth(self, time: float) -> float:
        """Return the inserted depth in m, never below zero.

        For a hand the depth is measured along the shaft, and for a template along the aim.
        """
        return self._motion.depth(time)

    def needle(self, time: float) -> Needle:
        """Return the part of the needle that is inside the tissue at a time in s, in T."""
        parameters, feed = self.parameters, self.parameters.feed
        radius = OUTER_DIAMETER[parameters.gauge] / 2
        aim = next(aim for start, aim in reversed(self._aims) if start <= time)
        entry, axes = aim.entry + self._offset, aim.axes(self._tilt)
        length = self.depth(time)
        if feed is not None and self.path is not None:
            length = self.path.length_at(length)
        if length <= 0 and feed is None:
            tip = entry + min(float(self._motion.steady_depth(time)), 0.0) * axes[0]
            return Needle(np.zeros((0, 3)), radius, np.array([tip, tip + axes[0]]))
        if self.path is None:
            along, first = np.array([[0, 0, 0], [length, 0, 0]]), np.eye(3)[0]
        else:
            along = self.path.positions(self._points(length), self._motion.cut(time, length))
            first = self.path.direction
        if feed is not None:
            along = np.vstack([-feed.template * first, along])
        return Needle(entry + along @ axes, radius)

    def _points(self, length: float) -> Floats:
        """Return distances in m along a bent shaft, from the entry to the tip."""
        if self.parameters.feed is None:
            return np.linspace(0, length, int(np.ceil(length / _SPACING)) + 1)
        # Behind a template the points stay in place from slice to slice.
        return np.append(np.arange(0, length, _FEED_SPACING), length)

    def _aims_of_pushes(self) -> list[tuple[float, "_Aim"]]:
        """Return the times in s from which aims hold, and the aims."""
        parameters = self.parameters
        durations = [push.duration for push in parameters.pushes]
        starts = parameters.start + np.cumsum([0.0, *durations])
        aim = _Aim(parameters.entry, parameters.azimuth_deg, parameters.dip_deg)
        aims = [(-np.inf, aim)]
        for number, (push, start) in enumerate(zip(parameters.pushes, starts, strict=False)):
            for name, value in push.aim.items():
                depth = float(self._motion.steady_depth(start))
                require(
                    depth <= 0,
                    f"pushes.{number}.{name}",
                    value,
                    f"left out: the needle is still {1e3 * depth:.1f} mm in the tissue",
                )
            if push.aim:
                aim = replace(aim, **push.aim)
                aims.append((float(start), aim))
        return aims


@dataclass(frozen=True)
class _Aim:
    """Entry and direction at which a needle is aimed; see `InsertionParameters`."""

    entry: list[float]
    azimuth_deg: float
    dip_deg: float

    def axes(self, tilt: Floats) -> Floats:
        """Return (3, 3) rows along the needle, up and beside it, in T, tilted by (2,) rad."""
        azimuth, dip = np.deg2rad([self.azimuth_deg, self.dip_deg]) + tilt
        heading = np.array([np.cos(azimuth), np.sin(azimuth), 0])
        up = np.array([0, 0, 1.0])
        direction = np.cos(dip) * heading - np.sin(dip) * up
        normal = np.sin(dip) * heading + np.cos(dip) * up
        return np.array([direction, normal, np.cross(direction, normal)])


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
