"""Scenarios in words, for reports."""

from sonoservo.diagrams.experiments.following_insertion import placed_hand
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.shape_prediction_scenario import ShapePredictionScenario
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER, InsertionParameters, Push

_MANY = 5
"""Number of pushes or moves from which they are summed up instead of listed."""


def following_words(scenario: FollowingScenario) -> list[str]:
    """Return sentences that describe a scenario of following."""
    hand, imaging, probe = placed_hand(scenario), scenario.imaging, scenario.station.probe
    servo = scenario.controller.settings
    sentences = [
        _description(scenario.description),
        f"The phantom is {scenario.phantom}, the probe {scenario.probe} on the arm "
        f"{scenario.station.arm}; it starts {1e3 * probe.height:.0f} mm above the phantom, turned "
        f"by {probe.yaw_deg:g} deg, and acquires {imaging.volume_rate:g} volumes a second, "
        f"{1e3 * imaging.depth:.0f} mm deep, at {1e-6 * imaging.transmit_frequency:g} MHz.",
        f"{_needle(hand)} enters {1e3 * -_depth(hand):.0f} mm below the middle of the phantom's "
        f"top, heads {hand.azimuth_deg:g} deg from the phantom's X axis and {hand.dip_deg:g} deg "
        f"downwards, and {_pushes(hand)}.",
        _motion(scenario),
        f"The tracker is {scenario.tracker.kind}; the visual servo's gain is {servo.gain:g}/s"
        f"{'' if servo.gain else ', so the probe only presses,'} and the contact force "
        f"{servo.force:g} N.",
    ]
    return [each for each in sentences if each]


def shape_words(scenario: ShapePredictionScenario) -> list[str]:
    """Return sentences that describe a scenario of shape prediction."""
    turned = ", ".join(f"{1e3 * each:g}" for each in scenario.rotations)
    bevel = f"Its bevel is turned at {turned} mm." if turned else "Its bevel is never turned."
    seen = scenario.observe_until
    used = "all of them" if seen is None else f"those of the first {1e3 * seen:g} mm"
    return [
        _description(scenario.description),
        f"{_needle(scenario.hand)} is fed {1e3 * scenario.depth:g} mm deep into {scenario.phantom} "
        f"at {1e3 * scenario.feed.speed:g} mm/s. {bevel}",
        f"The probe {scenario.probe} steps along and takes a slice every "
        f"{1e3 * scenario.step:g} mm; the estimator {scenario.estimator} uses {used}.",
    ]


def _description(text: str) -> str:
    return f"{text.rstrip('.')}." if text else ""


def _needle(hand: InsertionParameters) -> str:
    bend = hand.bend_radius
    kind = "straight" if bend is None else f"bending on a radius of {1e3 * bend:g} mm"
    return f"The needle ({hand.gauge} gauge, {1e3 * OUTER_DIAMETER[hand.gauge]:.2f} mm, {kind})"


def _depth(hand: InsertionParameters) -> float:
    return hand.entry[2] if hand.entry is not None else 0.0


def _pushes(hand: InsertionParameters) -> str:
    start = hand.start or 0.0
    if not hand.pushes:
        return "is not pushed"
    if len(hand.pushes) > _MANY:
        way = [each.speed * each.duration for each in hand.pushes]
        inward, out = sum(each for each in way if each > 0), -sum(each for each in way if each < 0)
        return (
            f"moves in {len(way)} phases from {start:.1f} s on, {1e3 * inward:.0f} mm in and "
            f"{1e3 * out:.0f} mm out in all"
        )
    return f"is, from {start:.1f} s on, {', '.join(map(_push, hand.pushes))}"


def _push(push: Push) -> str:
    if push.speed == 0:
        return f"{'turned' if push.turning_deg else 'at rest'} for {push.duration:g} s"
    way, speed = 1e3 * abs(push.speed) * push.duration, 1e3 * abs(push.speed)
    return f"{'pushed' if push.speed > 0 else 'withdrawn'} by {way:.0f} mm at {speed:g} mm/s"


def _motion(scenario: FollowingScenario) -> str:
    motion = scenario.phantom_motion
    sentences = []
    if moves := motion.moves:
        times = ", ".join(f"{each.start:g}" for each in moves)
        when = f"at {times} s" if len(moves) <= _MANY else f"{len(moves)} times"
        sentences.append(f"The phantom is moved {when}.")
    if motion.breathing.peak_to_peak:
        peak, rate = 1e3 * motion.breathing.peak_to_peak, motion.breathing.rate
        sentences.append(f"It breathes by {peak:g} mm, {60 * rate:g} times a minute.")
    return " ".join(sentences)
