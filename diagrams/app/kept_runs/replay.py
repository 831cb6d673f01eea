"""Replay of a kept run in the console: its slices, strips and world, at any time and speed."""

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.diagrams.app.kept_runs.compare import KeptResults, read_kept_results
from sonoservo.diagrams.app.kept_runs.kept_run import PICTURES
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.systems.control.controller_schedule import ControllerSchedule
from sonoservo.systems.display.console.controls import Control
from sonoservo.systems.display.console.readings import MINUTE, Frame, Sample, needle_place
from sonoservo.systems.display.console.slices import SlicePicture, kept_slice
from sonoservo.systems.evaluation.reports.track_plots import VolumePictures, read_pictures
from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.guard_status import GuardState
from sonoservo.systems.signals.planes import Plane

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_SAMPLING = 1 / 8  # Time between samples of the strips, in s
_LOOK = 1 / 16  # Time between two looks at the console, in s
_FASTEST = 8.0  # Speed of a replay as fast as possible, as a multiple of real time
_DECIBELS = 60.0  # Dynamic range of the kept pictures, in dB, unless the run's log says otherwise


@dataclass(frozen=True, eq=False)
class Replay:
    """What the console shows of a kept run: its title, samples and frames, in order of time."""

    title: str
    samples: Sequence[Sample]
    frames: Sequence[Frame]

    @property
    def end(self) -> float:
        """Time of the last sample or volume, in s."""
        return max(each[-1].time for each in (self.samples, self.frames) if each)

    def play(
        self,
        console: "Console",
        *,
        once: bool = False,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Play the run on a console until its stop is pressed or, with ``once``, to its end."""
        controls = console.controls
        slider = Control(
            name="time", port="", label="time", unit_label="s", unit=1.0, least=0.0, most=self.end,
            step=0.1, keys=("ArrowLeft", "ArrowRight"),
        )  # fmt: skip
        controls.offer([slider])
        controls.offer_buttons("pause", "step", "stop", speed=1.0)
        absent = ["planes", "cine", "probability", *([] if self.frames else ["slices"])]
        console.say(without=[*absent, *([] if console.facts["world"] else ["world"])])
        position, paused, last = 0.0, False, clock()
        shown = self._show(console, -math.inf, position, paused)
        while True:
            sleep(_LOOK)
            now = clock()
            passed, last = now - last, now
            pressed = controls.pressed()
            if "stop" in pressed:
                return
            if "pause" in pressed:
                paused = not paused
                position = 0.0 if not paused and position >= self.end else position
            if controls.value("time") != shown:
                position = controls.value("time")
            elif "step" in pressed:
                paused, position = True, self._next_volume(position)
            elif not paused:
                position += passed * (controls.speed or _FASTEST)
            if position >= self.end and not paused:
                if once:
                    self._show(console, shown, self.end, True)
                    return
                paused = True
            shown = self._show(console, shown, min(position, self.end), paused)
            position = shown

    def _next_volume(self, position: float) -> float:
        following = bisect_right(self.frames, position, key=lambda each: each.time)
        return self.frames[following].time if following < len(self.frames) else self.end

    def _show(self, console: "Console", before: float, position: float, paused: bool) -> float:
        """Show a time of the run in s, after another one; return it."""
        last = bisect_right(self.samples, position, key=lambda each: each.time)
        first = bisect_right(self.samples, before, key=lambda each: each.time)
        if position < before:  # the strips start anew
            first = bisect_right(self.samples, position - MINUTE, key=lambda each: each.time)
        for sample in self.samples[first:last]:
            console.add(sample)
        taken = bisect_right(self.frames, position, key=lambda each: each.time)
        if taken:
            console.show_frame(self.frames[taken - 1])
        note = "end of the run: move the time to look again" if position >= self.end else ""
        console.say(paused=paused, seek=round(position, 3), note=note)
        console.controls.move("time", position)
        return console.controls.value("time")


def read_replay(folder: str | Path) -> Replay:
    """Read a run in which the robot follows a needle; ConfigurationError if it is none."""
    folder = Path(folder)
    kept = read_kept_results(folder)
    if not isinstance(kept.log, RunLog):
        raise ConfigurationError(
            f"{folder} is a run of the experiment {kept.scenario.experiment!r}, which has no "
            f"volumes to replay; open {folder / 'report.html'}"
        )
    scenario = require_scenario(kept.scenario, FollowingScenario)
    samples = log_samples(kept.log, scenario.controller_schedule)
    if not samples:
        raise ConfigurationError(f"{folder}: the run was too short to replay")
    pictures = read_pictures(folder / PICTURES) if (folder / PICTURES).is_file() else []
    decibels = kept.summary.get("decibels_per_level") or _DECIBELS / 255
    frames = [_frame(number, each, decibels) for number, each in enumerate(pictures, 1)]
    return Replay(_title(kept), samples, _in_one_window(frames))


def log_samples(log: RunLog, settings: ControllerSchedule) -> list[Sample]:
    """Return the samples of the strips of a run, from its log and the controller's settings."""
    error = 1e3 * np.linalg.norm(
        log.estimate_tip - at_times(log, log.needle_tip, log.estimate_time), axis=1
    )
    seen_by = np.searchsorted(log.volume_seen, log.time, side="right") - 1
    samples: list[Sample] = []
    for row, now in enumerate(log.time.tolist()):
        if samples and now < samples[-1].time + _SAMPLING - 1e-9:
            continue
        seen, reason = int(seen_by[row]), ""
        if seen >= 0:
            searching = log.estimate_mode[row] == "searching"
            detection = str(log.volume_detection_reason[seen])
            reason = detection if searching else str(log.volume_measurement_reason[seen])
        acts = str(log.guard_state[row]) not in ("", GuardState.MONITORING)
        tip, place = log.estimate_tip[row], dict[str, Any]()
        if np.isfinite(tip).all():
            X_WP = RigidTransform(log.measured_X_WP[row])
            place = needle_place(log.estimate_entry[row], tip, X_WP)
        sample = Sample(
            time=now, mode=str(log.estimate_mode[row]), force=float(log.contact_force[row]),
            target=settings.at(now).force, error=float(error[row]), reason=reason,
            inserted=1e3 * float(log.inserted_length[row]), held=str(log.hold_reason[row]),
            stopped=str(log.guard_reason[row]) if acts else "", **place,
        )  # fmt: skip
        samples.append(sample)
    return samples


def _frame(number: int, pictures: VolumePictures, decibels: float) -> Frame:
    shown = []
    for plane, picture in enumerate(pictures.planes):
        left, right, bottom, top = 1e-3 * np.array(picture.extent)
        place = Plane(picture.X_PS, right - left, bottom - top)
        flat = np.column_stack([1e-3 * picture.needle, np.zeros(len(picture.needle))])
        needle = picture.X_PS.multiply(flat.T).T.reshape(-1, 3)
        shown.append(kept_slice(plane, place, picture.grey, needle))
    return Frame(number, pictures.time, str(pictures.mode), shown, decibels)


def _in_one_window(frames: Sequence[Frame]) -> list[Frame]:
    """Return frames whose slices are shown at one scale, each around its own middle."""
    pictures = [picture for frame in frames for picture in frame.pictures if picture is not None]
    if not pictures:
        return []
    width, height = np.max([each.size for each in pictures], axis=0).tolist()

    def widen(picture: SlicePicture) -> SlicePicture:
        left, right, top, bottom = picture.window
        x, y = 0.5 * (left + right), 0.5 * (top + bottom)
        window = x - 0.5 * width, x + 0.5 * width, y - 0.5 * height, y + 0.5 * height
        return replace(picture, window=window)

    return [
        replace(frame, pictures=[widen(each) for each in frame.pictures if each is not None])
        for frame in frames
    ]


def _title(kept: KeptResults) -> str:
    return f"{kept.scenario.name}, seed {kept.scenario.seed}, replayed"
