"""An operator's hand in the loop: what it does is recorded, and nothing it does stops the run."""

import json
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from sonoservo.diagrams import RunResult, drive, load_scenario, run
from sonoservo.diagrams.app.cli import app
from sonoservo.systems.display import Console

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


def test_a_drive_is_saved_recorded_and_repeated(console, tmp_path):
    script = [
        (0.2, slide("depth", 20)),
        (0.3, slide("turn", 45)),
        (0.4, slide("x", 8)),
        (0.6, slide("gain", 0.5)),
        (0.6, slide("force", 3.0)),
        (1.5, click("save")),
        (1.7, slide("depth", 15)),
        (1.7, slide("azimuth", 10)),
    ]
    operator = Operator(console, script)
    result = drive(cheap(2.2), console, out=tmp_path, show=operator)
    recorded = load_scenario(tmp_path / "scenario.yaml")
    assert recorded.duration == 2.2
    assert len(recorded.hand.pushes) > 4
    assert len(recorded.phantom_motion.moves) == 1
    assert [change.force for change in recorded.controller_changes] == [3.0]
    first, again = result.log, run(recorded).log
    assert np.nanmax(first.inserted_length) == pytest.approx(0.02, abs=1e-3)
    assert np.ptp(first.X_WT[:, 0, 3]) == pytest.approx(0.008, abs=1e-4)
    for name in ("needle_points", "X_WT", "X_WP", "contact_force", "volume_estimate_tip"):
        np.testing.assert_allclose(getattr(again, name), getattr(first, name), rtol=0, atol=1e-9)
    saved = load_scenario(tmp_path / "scenario_1.yaml")
    assert 1.5 <= saved.duration < 2.2
    assert saved.hand.pushes[:-1] == recorded.hand.pushes[: len(saved.hand.pushes) - 1]
    assert {path.name for path in tmp_path.iterdir()} >= {"log.npz", "run.png", "report.html"}
    assert json.loads((tmp_path / "summary.json").read_text())["force"]["rms_error_n"] is None
    assert any("aim it when it is outside" in text for *_, text in operator.seen)


def test_pause_stops_time_and_none_is_made_up_for(console):
    resumed = []

    def pause(simulated, text):
        operator(simulated, text)
        if text.startswith("paused") and len(operator.seen) > 30:
            operator.seen.clear()
            operator.controls.press("pause")
            resumed.append((time.perf_counter(), simulated))

    operator = Operator(console, [(0.5, click("pause"))])
    result = drive(cheap(1.2), console, show=pause)
    ((real, simulated),) = resumed
    assert 0.5 <= simulated < 1.2
    assert result.log.time[-1] == pytest.approx(1.2, abs=0.05)
    for now, time_then, _ in operator.seen:
        assert time_then - simulated <= now - real + 0.1


def test_a_restart_keeps_what_was_done_before_and_an_earlier_drive(console, tmp_path):
    (tmp_path / "scenario.yaml").write_text("of an earlier drive")
    operator = Operator(console, [(0.2, slide("depth", 20)), (0.7, click("restart"))])
    result = drive(cheap(0.9), console, out=tmp_path, show=operator)
    assert (tmp_path / "scenario_1.yaml").read_text() == "of an earlier drive"
    before = load_scenario(tmp_path / "scenario_2.yaml")
    assert before.duration >= 0.7
    assert max(push.speed for push in before.hand.pushes) > 0
    assert result.log.time[-1] == pytest.approx(0.9, abs=0.05)
    assert not result.log.inserted_length.any()


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
