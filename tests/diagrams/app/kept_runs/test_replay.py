"""Replay of a kept run: what is read, and what the controls of the console do."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from commands import sonoservo_here
from synthetic_logs import build_insertion_log
from synthetic_volumes import ENTRY, Scene

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.app.kept_runs.replay import log_samples, read_replay
from sonoservo.systems.control.controller_schedule import (
    ControllerChange,
    ControllerSchedule,
    ControllerSettings,
)
from sonoservo.systems.display import Console
from sonoservo.systems.display.console.console import picture_volume
from sonoservo.systems.evaluation import RunLog, picture_planes, read_pictures, summarize
from sonoservo.systems.evaluation.log import columns, write_log
from sonoservo.systems.evaluation.reports.track_plots import write_pictures
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically, write_json
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

TIP = ENTRY + np.array([0.045, 0.010, 0.004])


@pytest.fixture(scope="module")
def shown():
    """A volume with a needle, and the estimate in it."""
    volume = Scene(seed=3).volume(2, lambda time: (ENTRY, TIP))
    curve = NeedleCurve([ENTRY, TIP])
    return volume, NeedleEstimate(
        TrackingMode.TRACKING, volume.time, curve, np.zeros((2, 3)), np.eye(12), volume.time
    )


@pytest.fixture
def pictures(shown):
    """Pictures of two volumes; nothing was found in the first."""
    volume, estimate = shown
    return [
        picture_planes(replace(volume, time=1.0), TrackingMode.SEARCHING, None),
        picture_planes(replace(volume, time=5.0), TrackingMode.TRACKING, estimate.curve),
    ]


@pytest.fixture
def folder(tmp_path, pictures):
    """Folder of a run without simulating it."""
    log = build_insertion_log()
    scenario = load_scenario("chatelain2013_fig5")
    write_atomically(tmp_path / "run" / "scenario.yaml", scenario.to_yaml())
    write_log(tmp_path / "run" / "log.npz", log)
    write_json(tmp_path / "run" / "summary.json", summarize(log))
    write_pictures(tmp_path / "run" / "slices.npz", pictures)
    return tmp_path / "run"


def test_pictures_are_read_as_they_were_written(pictures, tmp_path):
    path = write_pictures(tmp_path / "slices.npz", pictures)
    for read, written in zip(read_pictures(path), pictures, strict=True):
        assert (read.time, read.mode) == (written.time, written.mode)
        for one, other in zip(read.planes, written.planes, strict=True):
            np.testing.assert_array_equal(one.grey, other.grey)
            np.testing.assert_array_equal(one.needle, other.needle)
            assert one.X_PS.IsNearlyEqualTo(other.X_PS, 1e-15)
            assert one.extent == other.extent
    assert read_pictures(write_pictures(tmp_path / "none.npz", [])) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", np.array(7)),
        ("length", np.array([-1, 1, 1, 1])),
        ("extent", np.full((4, 4), np.nan)),
        ("jpeg", None),
    ],
)
def test_damaged_pictures_are_refused(pictures, tmp_path, name, value):
    path = write_pictures(tmp_path / "slices.npz", pictures)
    with np.load(path) as file:
        arrays = dict(file)
    arrays[name] = np.zeros_like(arrays["jpeg"]) if value is None else value
    np.savez(path, **arrays)
    with pytest.raises(ConfigurationError, match=r"slices\.npz"):
        read_pictures(path)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ConfigurationError, match=r"slices\.npz"):
        read_pictures(path)


def test_slices_lie_as_they_did_in_the_run(folder, shown):
    volume, estimate = shown
    frame = read_replay(folder).frames[1]
    live = picture_volume(volume, estimate, 2)
    assert (frame.number, frame.time, frame.mode) == (2, 5.0, "tracking")
    for kept, drawn in zip(frame.pictures, live.pictures, strict=True):
        assert (kept.title, kept.axes) == (drawn.title, drawn.axes)
        np.testing.assert_allclose(kept.tip, drawn.tip, atol=1e-9)
        np.testing.assert_allclose(kept.rails, drawn.rails, atol=1e-9)
        # Its brightest column and row are the needle's, in both.
        at = [
            picture.corner
            + np.array(picture.size)
            * [each.mean() / length for each, length in
               ((np.nonzero(picture.grey > 150)[1], picture.grey.shape[1]),
                (np.nonzero(picture.grey > 150)[0], picture.grey.shape[0]))]
            for picture in (kept, drawn)
        ]  # fmt: skip
        np.testing.assert_allclose(*at, atol=1.5)


def test_strips_show_what_the_log_has(folder):
    log = build_insertion_log()
    settings = ControllerSchedule(
        ControllerSettings(1.6, 2.0), (ControllerChange(time=1.0, force=3.0),)
    )
    samples = log_samples(log, settings)
    assert [each.target for each in samples] == [2.0 + (each.time >= 1) for each in samples]
    assert np.diff([each.time for each in samples]) == pytest.approx(1 / 8)
    assert {each.mode for each in samples} == {"searching", "tracking"}
    last = samples[-1]
    # The probe stands over X = 50 mm, and looks down; the estimate is 0.3 and 0.4 mm off.
    assert (last.x, last.force) == (pytest.approx(0.3), pytest.approx(2.0))
    assert np.isnan(samples[0].x)
    stopped = replace(log, guard_state=np.full(len(log.time), "holding"),
                      guard_reason=np.full(len(log.time), "the force is above 6 N"))  # fmt: skip
    assert log_samples(stopped, settings)[0].stopped == "the force is above 6 N"
    assert not samples[0].stopped


class User:
    """Acts on the controls at given turns of the player's loop; each turn takes 1 s."""

    def __init__(self, console, acts):
        self.console, self.acts, self.turns, self.seen = console, acts, 0, []

    def clock(self):
        return float(self.turns)

    def sleep(self, seconds):
        self.turns += 1
        self.seen.append(self.console.facts.get("seek"))
        for act, value in self.acts.get(self.turns, ()):
            if act == "move":
                self.console.controls.move("time", value)
            elif act == "speed":
                self.console.controls.set_speed(value)
            else:
                self.console.controls.press(value)


def play(replay, acts, **options):
    with closing(Console(world=None)) as console:
        user = User(console, acts)
        replay.play(console, clock=user.clock, sleep=user.sleep, **options)
        return console, user.seen[1:]


def test_it_plays_pauses_steps_and_turns_back(folder):
    replay = read_replay(folder)
    press = lambda button: [("press", button)]  # noqa: E731
    acts = {3: press("pause"), 4: press("step"), 5: [("move", 12.0)], 6: press("pause"),
            7: [("speed", 2.0)], 8: [("move", 2.0)], 10: press("stop")}  # fmt: skip
    console, seen = play(replay, acts)
    assert seen == [1.0, 2.0, 2.0, 5.0, 12.0, 13.0, 15.0, 2.0, 4.0]
    assert console.frame().time == 1.0  # the newest volume before 4 s
    assert console.strips.newest.time == pytest.approx(4.0)
    assert {"planes", "cine", "world"} <= set(console.facts["without"])


def test_at_its_end_it_waits_and_starts_again(folder):
    replay = read_replay(folder)
    acts = {1: [("move", 19.5)], 3: [("press", "pause")], 5: [("press", "stop")]}
    console, seen = play(replay, acts)
    assert seen == pytest.approx([19.5, replay.end, 1.0, 2.0])
    assert not console.facts["note"]


def test_a_run_without_pictures_has_strips_only(folder):
    (folder / "slices.npz").unlink()
    console, _ = play(read_replay(folder), {2: [("press", "stop")]})
    assert "slices" in console.facts["without"]


def test_what_is_no_run_of_following_is_refused(folder, tmp_path):
    with pytest.raises(ConfigurationError, match="no such folder"):
        read_replay(tmp_path / "nowhere")
    (folder / "log.npz").unlink()
    with pytest.raises(ConfigurationError, match=r"no log\.npz"):
        read_replay(folder)


def test_the_command_plays_a_run(folder):
    log = build_insertion_log()
    samples = [name for name, column in columns(RunLog).items() if column.shape[0] == "n"]
    write_log(
        folder / "log.npz", replace(log, **{name: getattr(log, name)[:9] for name in samples})
    )
    (folder / "slices.npz").unlink()
    result = sonoservo_here("replay", str(folder), "--once", "--no-open")
    assert result.returncode == 0, result.stderr
    assert "Watch at http://localhost" in result.stdout
    assert "run with a page or with --replay" in result.stdout
