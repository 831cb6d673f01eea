"""Words, plots and pictures of the runs in which a robot follows a needle."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import placed_hand
from sonoservo.diagrams.experiments.presenter import Presenter, description, needle_words
from sonoservo.systems.evaluation.labels import LABELS
from sonoservo.systems.evaluation.reports.key_frames import plot_key_frames
from sonoservo.systems.evaluation.reports.movie import movie_frames
from sonoservo.systems.evaluation.reports.plots import (
    CAPTION,
    ERRORS_CAPTION,
    RUN_CAPTION,
    plot_comparison,
    plot_errors,
    plot_run,
)
from sonoservo.systems.evaluation.reports.verdict import Verdict, following_verdict
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.needle.insertion_parameters import InsertionParameters, Push

_MANY = 5  # number of pushes or moves from which they are summed up instead of listed


class FollowingPresenter(Presenter):
    """Presents the runs of a `FollowingExperiment`."""

    labels = LABELS
    overlay_caption = CAPTION
    overlay = staticmethod(plot_comparison)

    def plots(self, log: RunLog) -> dict[str, tuple[str, Figure]]:
        """Return the plots of a run and of its errors."""
        return {
            "run.png": (RUN_CAPTION, plot_run(log, self._experiment.force_target)),
            "errors.png": (ERRORS_CAPTION, plot_errors(log)),
        }

    def verdict(self, summary: Mapping[str, Any]) -> Verdict:
        """Return the verdict on a run, from its summary."""
        follows = self._experiment.scenario.controller.settings.gain > 0
        return following_verdict(summary, follows=follows)

    def words(self) -> list[str]:
        """Return sentences that describe what was run, with the tracker that ran."""
        scenario: FollowingScenario = self._experiment.happened()
        return following_words(scenario, self._experiment.own_tracker)

    def key_frames(self, log: RunLog) -> dict[str, Figure]:
        """Return pictures of a run's telling moments, by caption; none unless they were kept."""
        return plot_key_frames(log, self._experiment.pictures)

    def frames(self, log: RunLog) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames of a movie, one per volume."""
        return movie_frames(log, self._experiment.pictures)

    @property
    def frame_rate(self) -> float:
        """Volumes per second."""
        return float(self._experiment.scenario.imaging.volume_rate)


def following_words(scenario: FollowingScenario, tracker: str = "") -> list[str]:
    """Return sentences that describe a run with the scenario's tracker, or another one."""
    ran = tracker or scenario.tracker.kind
    hand, imaging, probe = placed_hand(scenario), scenario.imaging, scenario.station.probe
    servo = scenario.controller.settings
    entry = ", ".join(f"{1e3 * each:z.0f}" for each in hand.entry or ())
    sentences = [
        description(scenario.description),
        f"The phantom is {scenario.phantom}, the probe {scenario.probe} on the arm "
        f"{scenario.station.arm}; it starts {1e3 * probe.height:.0f} mm above the phantom, turned "
        f"by {probe.yaw_deg:g} deg, and acquires {imaging.volume_rate:g} volumes a second, "
        f"{1e3 * imaging.depth:.0f} mm deep, at {1e-6 * imaging.transmit_frequency:g} MHz.",
        f"{needle_words(hand)} enters at ({entry}) mm from the middle of the phantom's top, "
        f"heads {hand.azimuth_deg:.3g} deg from the phantom's X axis and "
        f"{hand.dip_deg:.3g} deg downwards, and {_pushes(hand)}.",
        _motion(scenario),
        f"The tracker is {ran}; the visual servo's gain is {servo.gain:g}/s"
        f"{'' if servo.gain else ', so the probe only presses,'} and the contact force "
        f"{servo.force:g} N.",
    ]
    return [each for each in sentences if each]


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
        sentences.append(f"The phantom breathes by {peak:g} mm, {60 * rate:g} times a minute.")
    return " ".join(sentences)
