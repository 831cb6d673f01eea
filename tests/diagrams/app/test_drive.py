"""An operator's hand in the loop: what it does is recorded, and nothing it does stops the run."""

import json
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from typer.testing import CliRunner

from sonoservo.diagrams import load_scenario, run
from sonoservo.diagrams.app.cli import app
from sonoservo.diagrams.app.drive import drive
from sonoservo.diagrams.app.run_result import RunResult
from sonoservo.systems.display.console.console import Console
from sonoservo.systems.evaluation.log import read_log
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals import NeedleEstimate, TrackingMode

CHEAP = [
    "station.plant.contact_model=point",
    "station.probe.height=0.004",
    "imaging.sector=0.4",
    "imaging.frames=9",
]


def cheap(duration):
    return replace(load_scenario("drive", changes=CHEAP, seed=7), duration=duration)


@pytest.fixture(scope="module")
def console():
    with closing(Console()) as console:
        yield console


class Operator:
    """Does what a script says at simulated times, and watches."""

    def __init__(self, console, script):
        self.controls, self._script = console.controls, list(script)
        self.seen = []

    def __call__(self, simulated, text):
        self.seen.append((time.perf_counter(), simulated, text))
        while self._script and simulated >= self._script[0][0]:
            _, act = self._script.pop(0)
            act(self.controls)


def slide(name, value):
    return lambda controls: controls.move(name, value)


def click(name):
    return lambda controls: controls.press(name)


@pytest.fixture(scope="module")
def driven(console, tmp_path_factory):
    """A drive of 4 s, its result and its folder."""
    folder = tmp_path_factory.mktemp("drive")
    script = [
        (0.2, slide("depth", 30)),
        (0.5, slide("turn", 45)),
        (1.0, slide("x", 15)),
        (1.5, slide("gain", 0.5)),
        (1.5, slide("force", 3.0)),
        (2.5, click("save")),
        (3.0, slide("depth", 25)),
        (3.0, slide("azimuth", 10)),
    ]
    operator = Operator(console, script)
    result = drive(cheap(4.0), console, out=folder, show=operator)
    return result, folder, operator


def test_the_recorded_scenario_repeats_the_run(driven):
    result, folder, _ = driven
    recorded = load_scenario(folder / "scenario.yaml")
    assert recorded.duration == 4.0
    assert len(recorded.hand.pushes) > 5
    assert len(recorded.phantom_motion.moves) == 1
    assert [change.force for change in recorded.controller_changes] == [3.0]
    first, again = result.log, run(recorded).log
    assert np.nanmax(first.inserted_length) == pytest.approx(0.03, abs=1e-3)
    assert np.ptp(first.X_WT[:, 0, 3]) == pytest.approx(0.015, abs=1e-4)
    for name in ("needle_points", "X_WT", "X_WP", "contact_force", "volume_estimate_tip"):
        np.testing.assert_allclose(getattr(again, name), getattr(first, name), rtol=0, atol=1e-9)


def test_what_was_saved_on_the_way_is_a_scenario_too(driven):
    _, folder, _ = driven
    saved = load_scenario(folder / "scenario_1.yaml")
    assert 2.5 <= saved.duration < 4.0
    whole = load_scenario(folder / "scenario.yaml").hand.pushes
    assert saved.hand.pushes[:-1] == whole[: len(saved.hand.pushes) - 1]


def test_it_leaves_what_a_run_leaves(driven):
    result, folder, operator = driven
    names = {path.name for path in folder.iterdir()}
    assert names >= {"scenario.yaml", "summary.json", "log.npz", "run.png", "report.html"}
    assert json.loads((folder / "summary.json").read_text())["force"]["rms_error_n"] is None
    np.testing.assert_array_equal(read_log(folder / "log.npz", RunLog).time, result.log.time)
    assert any("aim it when it is outside" in text for *_, text in operator.seen)


def test_a_tracker_of_one_s_own_may_be_driven_with(console):
    def blind(volume):
        return NeedleEstimate(TrackingMode.SEARCHING, volume.time, volume_time=volume.time)

    log = drive(cheap(1.0), console, tracker=blind).log
    assert len(log.volume_time) > 1
    assert set(log.volume_estimate_mode) == {"searching"}


def test_pause_stops_time_and_none_is_made_up_for(console):
    resumed = []

    def pause(simulated, text):
        operator(simulated, text)
        if text.startswith("paused") and len(operator.seen) > 30:
            operator.seen.clear()
            operator.controls.press("pause")
            resumed.append((time.perf_counter(), simulated))

    operator = Operator(console, [(0.5, click("pause"))])
    result = drive(cheap(2.0), console, show=pause)
    ((real, simulated),) = resumed
    assert 0.5 <= simulated < 1.5
    assert result.log.time[-1] == pytest.approx(2.0, abs=0.05)
    for now, time_then, _ in operator.seen:
        assert time_then - simulated <= now - real + 0.1


def test_a_restart_keeps_what_was_done_before(console, tmp_path):
    operator = Operator(console, [(0.2, slide("depth", 20)), (1.2, click("restart"))])
    meshcat = Meshcat()
    result = drive(cheap(1.5), console, meshcat=meshcat, out=tmp_path, show=operator)
    assert (tmp_path / "replay.html").is_file()
    assert load_scenario(tmp_path / "scenario_1.yaml").duration >= 1.2
    assert max(push.speed for push in load_scenario(tmp_path / "scenario_1.yaml").hand.pushes) > 0
    assert result.log.time[-1] == pytest.approx(1.5, abs=0.05)
    assert not result.log.inserted_length.any()
    assert result.summary["detection"]["advice"] == "Push it in before the run ends."  # no fields


def test_an_earlier_drive_into_the_same_folder_is_kept(console, tmp_path):
    (tmp_path / "scenario.yaml").write_text("of an earlier drive")
    drive(cheap(0.5), console, out=tmp_path)
    assert (tmp_path / "scenario_1.yaml").read_text() == "of an earlier drive"
    assert load_scenario(tmp_path / "scenario.yaml").duration == 0.5


@pytest.mark.parametrize(("reason", "status"), [("too much force", 3), (None, 0)])
def test_a_drive_that_ends_stopped_has_exit_status_3(tmp_path, monkeypatch, reason, status):
    summary = {"scenario": "drive", "seed": 0, "guard": {"stopped_at_end": reason}}
    ended = RunResult(summary=summary, log=None, labels={})
    monkeypatch.setattr("sonoservo.diagrams.app.drive.drive", lambda *_, **__: ended)
    arguments = ["drive", "--out", str(tmp_path), "--json", str(tmp_path / "printed.json")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == status
    assert json.loads((tmp_path / "printed.json").read_text()) == summary
    said = " ".join(result.output.split())
    assert (f"still stopped at the end because {reason}" in said) == bool(reason)
