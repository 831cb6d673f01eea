"""Parameters of a track's life."""

from dataclasses import dataclass

from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive


@dataclass(kw_only=True)
class TrackParameters:
    """Rules for the start, the gate and the end of a track. The papers publish no values.

    Parameters
    ----------
    first_std
        Standard deviation of the control points at a detection, in m.
    min_advance
        Distance by which the tip must advance from the first to the last of successive detections,
        in m.
    max_detection_jump
        Largest distance of the tip between successive detections, in m.
    gate
        Probability that a true measurement passes the gate on the innovation.
    max_jump
        Distance of every control point from its prediction up to which a measurement shows the same
        needle although it fails the gate, in m. The needle was then moved as no model foresees, and
        the filter starts anew.
    grown_length, seconds_to_grow
        Length in m that a needle must reach within a time in s after it was found. What does not is
        given up.
    sure_length, seconds_to_be_sure
        Length in m from which on what is followed surely is a needle, if it has grown by
        ``grown_length`` or was followed for a time in s, without a loss or a turn. Before, a needle
        must be seen to come.
    volumes_to_confirm
        Number of volumes within which a detection must be repeated and the needle be localized.
    volumes_to_lose
        Number of successive volumes without the needle after which it is lost and the whole volume
        is searched.
    volumes_to_follow
        Number of successive volumes that must show a needle found in the whole volume before it is
        followed. Until then no robot moves for it.
    seconds_between_searches
        Time between two searches in the whole volume while no insertion is seen, in s. They find a
        needle that moves too slowly, or from too deep, to be noticed. Zero switches them off.
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
    max_approach
        Largest motion of the probe along its axis during a sweep, in m, at which a needle may be
        found anywhere. A probe that lands shows the edge of its contact, which looks like a needle.
    probe_frame
        Whether the needle's state is kept in the probe's frame, as in Chatelain 2013. The state
        then moves along with the probe, and its velocity is that in the image, which suits only the
        servo without feed-forward. If not, the state is kept in W.
    """

    first_std: float = 1.0e-3
    min_advance: float = 2.5e-3
    max_detection_jump: float = 10e-3
    gate: float = 0.9999
    max_jump: float = 4e-3
    grown_length: float = 10e-3
    seconds_to_grow: float = 3.0
    sure_length: float = 20e-3
    seconds_to_be_sure: float = 3.0
    volumes_to_confirm: int = 4
    volumes_to_lose: int = 4
    volumes_to_follow: int = 3
    seconds_between_searches: float = 0.25
    withdrawn_length: float = 6e-3
    withdrawal_speed: float = 5e-3
    seconds_to_give_up: float = 10.0
    filtering: bool = True
    max_approach: float = 1.5e-3
    probe_frame: bool = False

    def __post_init__(self) -> None:
        require_positive(
            first_std=self.first_std,
            min_advance=self.min_advance,
            max_detection_jump=self.max_detection_jump,
            gate=self.gate,
            max_jump=self.max_jump,
            grown_length=self.grown_length,
            seconds_to_grow=self.seconds_to_grow,
            sure_length=self.sure_length,
            withdrawn_length=self.withdrawn_length,
            withdrawal_speed=self.withdrawal_speed,
            seconds_to_give_up=self.seconds_to_give_up,
            max_approach=self.max_approach,
        )
        require_not_negative(
            seconds_between_searches=self.seconds_between_searches,
            seconds_to_be_sure=self.seconds_to_be_sure,
        )
        require(
            self.sure_length >= self.grown_length,
            "sure_length",
            self.sure_length,
            f"grown_length, {self.grown_length}, or more",
        )
        require(self.gate < 1, "gate", self.gate, "below 1")
        for name in ("volumes_to_confirm", "volumes_to_lose", "volumes_to_follow"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "1 or more")
