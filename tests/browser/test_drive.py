"""Sliders, buttons and keys in the page act on the running simulation."""

from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams import load_scenario, run
from sonoservo.diagrams.app.drive import drive
from sonoservo.diagrams.app.kept_run import KeptRun

CHEAP = [
    "station.plant.contact_model=point",
    "station.plant.time_step=0.01",
    "controller.time_step=0.01",
    "station.probe.height=0.004",
]


def slide(page, name, fraction):
    """Click on a slider at a fraction of its width; return the number that it then shows."""
    row = page.locator(".cr", has_text=name)
    bar = row.locator(".slider")
    bar.scroll_into_view_if_needed()
    box = bar.bounding_box()
    page.mouse.click(box["x"] + fraction * box["width"], box["y"] + box["height"] / 2)
    return float(row.locator("input").input_value())


@pytest.mark.viewport(480, 360)
def test_the_page_drives_the_simulation(meshcat, open_page, tmp_path, monkeypatch):
    monkeypatch.setattr(KeptRun, "write", lambda *_: None)  # plots, which other tests look at
    seen = {}

    def script():
        """Yields what to wait for, given the simulated time and what the run says."""
        page = open_page(meshcat.web_url())
        page.get_by_text("Open Controls").click()
        yield lambda time, text: time > 0.5
        for _ in range(12):
            page.keyboard.press("KeyW")
        seen["turn"] = slide(page, "turn (deg)", 0.625)
        seen["phantom"] = slide(page, "phantom x", 0.8)
        seen["lambda"] = slide(page, "lambda", 0.25)
        seen["force"] = slide(page, "force (N)", 0.5)
        yield lambda time, text: time > 2.0
        page.get_by_text("pause / resume").click()
        yield lambda time, text: text == "paused"
        for _ in range(10):
            stopped = yield lambda time, text: True
            seen.setdefault("stopped", set()).add(stopped)
        page.keyboard.press("Space")
        yield lambda time, text: time > 2.5
        page.get_by_text("save scenario").click()
        yield lambda time, text: (tmp_path / "scenario_1.yaml").exists()
        page.get_by_text("restart").click()
        yield lambda time, text: time < 1.0
        page.reload()
        page.get_by_text("Open Controls").click()
        second = open_page(meshcat.web_url())
        for _ in range(7):
            second.keyboard.press("KeyW")
        page.wait_for_function("viewer.gui_controllers['depth (mm) S W'].getValue() == 7")
        second.close()
        page.close()
        yield lambda time, text: time > 1.0
        last = open_page(meshcat.web_url())
        last.keyboard.press("KeyF")
        yield lambda time, text: False

    steps = script()
    wait = [None]

    def operate(time, text):
        if wait[0] is None:
            wait[0] = next(steps)
        elif wait[0](time, text):
            wait[0] = steps.send(time)

    scenario = replace(load_scenario("drive", changes=CHEAP), duration=60.0)
    result = drive(scenario, meshcat, out=tmp_path, show=operate)

    saved = load_scenario(tmp_path / "scenario_1.yaml")
    pushes = saved.hand.pushes
    assert sum(push.duration * push.speed for push in pushes) == pytest.approx(0.012)
    assert sum(push.duration * push.turning_deg for push in pushes) == pytest.approx(seen["turn"])
    assert seen["turn"] == pytest.approx(90, abs=15)
    (move,) = saved.phantom_motion.moves
    assert 1e3 * move.translation[0] == pytest.approx(seen["phantom"])
    changes = saved.controller_changes
    assert [each.gain for each in changes if each.gain is not None] == [
        pytest.approx(seen["lambda"])
    ]
    assert [each.force for each in changes if each.force is not None] == [
        pytest.approx(seen["force"])
    ]
    log = run(saved).log
    assert log.inserted_length[-1] == pytest.approx(0.012, abs=3e-4)
    assert log.contact_force[-1] == pytest.approx(seen["force"], abs=0.1)

    assert len(seen["stopped"]) == 1
    assert seen["stopped"].pop() < 3.0
    assert result.log.inserted_length[-1] == pytest.approx(0.007, abs=3e-4)
    assert 1.0 < result.log.time[-1] < 59
    again = run(load_scenario(tmp_path / "scenario.yaml")).log
    for name in ("needle_points", "X_WT", "X_WP"):
        np.testing.assert_allclose(
            getattr(again, name), getattr(result.log, name)[: len(again.time)], rtol=0, atol=1e-9
        )
