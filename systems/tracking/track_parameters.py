"""Parameters of a track's life."""

from dataclasses import dataclass
from typing import Annotated

from sonoservo.systems.signals.requirements import (
    Positive,
    between,
    check_bounds,
    require,
)


@dataclass(kw_only=True)
class TrackParameters:
    """Rules for the start, the gate and the end of a track. The papers publish no values.

    Parameters
    ----------
    act
        Least probability of being a needle at which filter and robot follow a line.
    gate
        Probability that a true measurement passes the gate on the innovation.
    volumes_to_lose
        Number of successive volumes without the needle after which it is lost and the whole volume
        is searched.
    volumes_to_follow
        Number of volumes in which a line at rest must look like a needle before it is followed.
    withdrawn_length
        Predicted length below which a needle that is not found counts as withdrawn, in m.
    withdrawal_speed
        Speed in m/s above which a needle that comes out is lost as soon as a volume does not show
        it. Any other one is lost after several such volumes.
    seconds_to_give_up
        Time without the needle after which a new insertion is awaited, in s.
    filtering
        Whether measurements are filtered. If not, each one starts the track anew, without a
        velocity for the prediction and without a gate on the innovation.
    probe_frame
        Whether the needle's state is kept in the probe's frame, as in Chatelain 2013. The state
        then moves along with the probe, and its velocity is that in the image, which suits only the
        servo without feed-forward. If not, the state is kept in W.
    """

    act: Annotated[float, between(0.5, 1)] = 0.95
    gate: Positive = 0.9999
    volumes_to_lose: int = 4
    volumes_to_follow: int = 3
    withdrawn_length: Positive = 6e-3
    withdrawal_speed: Positive = 5e-3
    seconds_to_give_up: Positive = 10.0
    filtering: bool = True
    probe_frame: bool = False

    def __post_init__(self) -> None:
        check_bounds(self)
        require(self.gate < 1, "gate", self.gate, "below 1")
        for name in ("volumes_to_lose", "volumes_to_follow"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "1 or more")
