"""Parameters of an insertion: the needle, its path and the hand or template that pushes it."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.bicycle_paths import require_rising
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    Positive,
    PositiveTime,
    Time,
    check_bounds,
    require,
    require_within,
    within,
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

DEFAULT_ENTRY = (-0.06, 0.0, -0.045)
"""Entry in T, in m, of an insertion whose parameters give neither an entry nor an experiment."""

_MAX_LENGTH = 0.5  # largest length of a needle, in m
MIN_BEND_RADIUS = 0.05  # smallest radius in m of the arc that a bevelled tip may cut


@dataclass(kw_only=True)
class Push:
    """One phase of an insertion by hand.

    Parameters
    ----------
    duration
        Duration in s.
    speed
        Speed in m/s. Zero is a pause, and a negative speed a withdrawal.
    turning_deg
        Rate at which the needle is turned about its axis, in deg/s. Turning steers a bevelled tip.
    entry
        Entry point in T from now on, in m; None leaves it unchanged. The needle must be outside.
    azimuth_deg, dip_deg
        Direction of the insertion from now on, in deg; None leaves it unchanged. A needle that is
        partly withdrawn, to at most 20 mm, turns about its entry to the new direction during the
        push, by at most 45 deg. One that is outside is aimed anew at once.
    """

    duration: PositiveTime = 1.0
    speed: float = 0.0
    turning_deg: float = 0.0
    entry: list[float] | None = None
    azimuth_deg: float | None = None
    dip_deg: float | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        turning_deg, dip_deg = self.turning_deg, self.dip_deg
        require(abs(turning_deg) <= 720, "turning_deg", turning_deg, "from -720 to 720 deg/s")
        allowed = dip_deg is None or abs(dip_deg) <= 90
        require(allowed, "dip_deg", dip_deg, "from -90 to 90 deg")
        if self.entry is not None:
            require(len(self.entry) == 3, "entry", self.entry, "three coordinates in m")
        require(abs(self.speed) <= 0.2, "speed", self.speed, "from -0.2 to 0.2 m/s")

    @property
    def aim(self) -> dict[str, Any]:
        """Changes of the entry and direction, by name."""
        if self.entry is None and self.azimuth_deg is None and self.dip_deg is None:
            return {}
        changed = {"entry": self.entry, "azimuth_deg": self.azimuth_deg, "dip_deg": self.dip_deg}
        return {name: value for name, value in changed.items() if value is not None}


@dataclass(kw_only=True)
class FeedParameters(Bounded):
    """Feed through a template, at constant speed along the aimed direction.

    Parameters
    ----------
    speed
        Speed along the aimed direction, in m/s.
    depth
        Depth by which the needle is fed in, in addition to ``lead``, in m.
    lead
        Depth at the start, in m. A probe that steps with the feed sees the shaft if the lead is
        longer than the tip, 3.5 mm with the bevel of gauge 18. The bevel sends most sound away.
    template
        Length of the straight needle between the template and the entry, in m.
    """

    speed: Positive = 0.01
    depth: Positive = 0.14
    lead: NotNegative = 5e-3
    template: Positive = 10e-3


@dataclass(kw_only=True)
class InsertionParameters:
    """Parameters of a needle, the path that it cuts, and the hand or template that pushes it.

    Spreads are half widths of uniform distributions, by which one insertion differs from the next.

    Parameters
    ----------
    gauge
        Gauge of the needle, which sets its diameter.
    entry
        Point in T at which the needle enters the tissue, or the first slice behind a template, in
        m. None leaves it to ``aim``; an insertion without an experiment then starts at
        `DEFAULT_ENTRY`.
    aim
        Point in T that the needle passes, in m; the entry is then where it pierces the phantom's
        surface. If both are None, the needle passes 45 mm below the probe, beside which it enters.
    initial_depth
        Length already in the tissue when the run begins, in m. None is 0, or, if neither ``entry``
        nor ``aim`` is given, all but the last 60 mm on the way below the probe.
    entry_spread
        Spread of each coordinate of the entry, in m. A template allows no spread along X.
    azimuth_deg
        Direction of the insertion seen from above, from +X_T towards +Y_T, in deg.
    dip_deg
        Angle of the insertion below the horizontal, in deg.
    angle_spread_deg
        Spread of azimuth and dip, in deg.
    azimuth_spread_deg
        Spread of the azimuth before the entry is computed from ``aim``, in deg; 180 for insertions
        from anywhere.
    bend_radius, bend_radius_spread
        Radius of the arc that a bevelled tip cuts, and its spread, in m. A radius of None gives a
        straight needle.
    mechanics
        How a bent needle moves: "bicycle", along the path that its tip cuts (`SteeredPath`), or
        "beam", as an elastic beam in tissue that yields to it, behind a template (`BeamPath`).
    bend_roll_deg, bend_roll_spread_deg
        Direction of the bend about the needle's axis at the start, and its spread, in deg; 0 bends
        upwards.
    bend_angle_spread_deg
        Spread of the first direction about the aimed one, within the plane of the bend, in deg.
    roll_spread_deg
        Spread of the roll of a straight needle's bevel, in deg; 180 for any. At 0, its face looks
        up.
    rotations
        Depths along the aimed direction at which the bevel is turned by 180 deg, in m.
    rotation_depth_spread, rotation_angle_spread_deg
        Spreads of the depth and of the angle at which the bevel is really turned, in m and in deg.
    bend_drift_spread_deg
        Spread of the angle by which the direction of the bend drifts over 0.1 m of path, in deg.
    curvature_wander
        Standard deviation of the curvature along the path in uneven tissue, relative to 1 / R.
    wander_length
        Correlation length of the curvature, in m. It is the standard deviation of the Gaussian that
        smooths the curvature.
    start
        Time at which the motion begins, in s. None waits until the probe has landed and the tracker
        has seen the tissue without a moving needle.
    pushes
        Phases of an insertion by hand, one after the other. After the last one the hand rests.
    ramp
        Time that the hand takes to change speed, in s.
    tremor
        Root mean square of the hand's tremor along the needle, in m.
    feed
        Feed through a template instead of a hand; None for a hand.
    """

    gauge: int = 18
    entry: list[float] | None = None
    aim: list[float] | None = None
    initial_depth: float | None = None
    entry_spread: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    azimuth_deg: float = 0.0
    dip_deg: float = 0.0
    angle_spread_deg: NotNegative = 0.0
    azimuth_spread_deg: NotNegative = 0.0
    bend_radius: float | None = None
    bend_radius_spread: NotNegative = 0.0
    mechanics: str = "bicycle"
    bend_roll_deg: float = 0.0
    bend_roll_spread_deg: NotNegative = 0.0
    bend_angle_spread_deg: Annotated[float, within(0, 20, " deg")] = 0.0
    roll_spread_deg: NotNegative = 0.0
    rotations: list[float] = field(default_factory=list)
    rotation_depth_spread: NotNegative = 0.0
    rotation_angle_spread_deg: NotNegative = 0.0
    bend_drift_spread_deg: NotNegative = 0.0
    curvature_wander: NotNegative = 0.0
    wander_length: Positive = 0.02
    start: Time | None = None
    pushes: list[Push] = field(default_factory=list)
    ramp: Positive = 0.5
    tremor: NotNegative = 0.0
    feed: FeedParameters | None = None

    def __post_init__(self) -> None:
        allowed = ", ".join(str(gauge) for gauge in OUTER_DIAMETER)
        require(self.gauge in OUTER_DIAMETER, "gauge", self.gauge, f"one of {allowed}")
        for name in ("entry", "aim"):
            point = getattr(self, name)
            require(point is None or len(point) == 3, name, point, "three coordinates in m")
        require(
            self.entry is None or self.aim is None,
            "aim",
            self.aim,
            "left out: entry already places the needle",
        )
        spread = self.entry_spread
        require(
            len(spread) == 3 and min(spread) >= 0,
            "entry_spread",
            spread,
            "three lengths in m of at least 0",
        )
        require(abs(self.dip_deg) <= 90, "dip_deg", self.dip_deg, "from -90 to 90 deg")
        check_bounds(self)
        require_within("initial_depth", self.initial_depth or 0.0, 0, _MAX_LENGTH)
        require_rising(self.rotations)
        gaps = np.diff([0.0, *self.rotations])
        require(
            not self.rotation_depth_spread
            or float(gaps.min(initial=1)) > 2 * self.rotation_depth_spread,
            "rotation_depth_spread",
            self.rotation_depth_spread,
            "below half of the distance between rotations",
        )
        if self.bend_radius is None:
            self._require_none(
                "a straight needle (bend_radius is null)",
                "bend_radius_spread", "bend_angle_spread_deg", "rotations", "curvature_wander",
                "bend_drift_spread_deg",
            )  # fmt: skip
        else:
            require(
                self.bend_radius - self.bend_radius_spread >= MIN_BEND_RADIUS,
                "bend_radius",
                self.bend_radius,
                f"at least {MIN_BEND_RADIUS:g} m after bend_radius_spread is subtracted",
            )
        kinds = ("bicycle", "beam")
        require(self.mechanics in kinds, "mechanics", self.mechanics, f"one of {', '.join(kinds)}")
        if self.mechanics == "beam":
            bent = self.bend_radius is not None and self.feed is not None
            require(bent, "mechanics", "beam", '"bicycle" without a bend_radius or without a feed')
            self._require_none(
                "a beam",
                "curvature_wander", "rotation_angle_spread_deg", "bend_drift_spread_deg",
            )  # fmt: skip
        if self.feed is not None:
            self._require_none(
                "a template (feed)",
                "aim", "initial_depth", "pushes", "tremor",
                "angle_spread_deg", "azimuth_spread_deg",
            )  # fmt: skip
            require(
                not self.rotations or self.rotations[-1] < self.feed.depth,
                "rotations",
                self.rotations,
                f"within the insertion, below feed.depth ({self.feed.depth} m)",
            )

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector in T along which the needle is aimed at first, without its spread."""
        azimuth, dip = np.deg2rad([self.azimuth_deg, self.dip_deg])
        level = np.cos(dip)
        return np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(dip)])

    def _require_none(self, what: str, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            require(not value, name, value, f"left out: {what} has none")
