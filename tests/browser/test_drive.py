"""Sliders, buttons and keys in the page act on the running simulation."""

from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams import load_scenario, run
from sonoservo.diagrams.app.drive import drive
from sonoservo.diagrams.app.kept_runs.kept_run import KeptRun
from sonoservo.systems.display.console.console import Console
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site

CHEAP = [
    "station.plant.contact_model=point",
    "station.probe.height=0.004",
]


@pytest.fixture
def pages():
    with Site() as site:
        meshcat = open_meshcat(site)
        yield meshcat, Console(site, world="world")


def slide(page, name, value):
    """Set a slider in the page."""
    page.locator(f"#sliders input[data-name={name}]").fill(str(value))


@pytest.mark.viewport(768, 600)  # few pixels, which a page without graphics chip draws sooner
@pytest.mark.slow
def test_the_page_drives_the_simulation(pages, open_page, tmp_path, monkeypatch):
    monkeypatch.setattr(KeptRun, "_write", lambda *_: None)  # plots, which other tests look at
    meshcat, console = pages
    seen = {}

    def script():
        """Yields what to wait for, given the simulated time and what the run says."""
        page = open_page(console.web_url)
        yield lambda time, text: time > 0.5
        page.click("#arm")
        for _ in range(12):
            page.keyboard.press("KeyW")
        for name, value in (("turn", 90), ("x", 15), ("gain", 0.5), ("force", 3.0)):
            slide(page, name, value)
        yield lambda time, text: time > 2.0
        page.click("[data-name=pause]")
        yield lambda time, text: text.startswith("paused")
        page.wait_for_function("document.getElementById('word').textContent.startsWith('paused')")
        for _ in range(10):
            stopped = yield lambda time, text: True
            seen.setdefault("stopped", set()).add(stopped)
        page.frame_locator("#world iframe").locator("canvas").first.click()
        page.keyboard.press("Space")  # while the world has the focus
        yield lambda time, text: time > 2.5
        page.click("[data-name=save]")
        yield lambda time, text: (tmp_path / "scenario_1.yaml").exists()
        page.click("[data-name=restart]")
        yield lambda time, text: time < 1.0
        page.reload()
        page.wait_for_selector("body[data-ready]", state="attached")
        second = open_page(console.web_url)
        second.click("#arm")
        for _ in range(7):
            second.keyboard.press("KeyW")
        page.wait_for_function("document.querySelector('#sliders output').textContent == '7 mm'")
        second.close()
        page.close()
        yield lambda time, text: time > 1.0
        last = open_page(console.web_url)
        last.click("#arm")
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
    result = drive(scenario, console, meshcat=meshcat, out=tmp_path, show=operate)

    saved = load_scenario(tmp_path / "scenario_1.yaml")
    pushes = saved.hand.pushes
    assert sum(push.duration * push.speed for push in pushes) == pytest.approx(0.012)
    assert sum(push.duration * push.turning_deg for push in pushes) == pytest.approx(90)
    (move,) = saved.phantom_motion.moves
    assert 1e3 * move.translation[0] == pytest.approx(15)
    changes = saved.controller_changes
    assert [each.gain for each in changes if each.gain is not None] == [pytest.approx(0.5)]
    assert [each.force for each in changes if each.force is not None] == [pytest.approx(3.0)]
    log = run(saved).log
    assert log.inserted_length[-1] == pytest.approx(0.012, abs=3e-4)
    assert log.contact_force[-1] == pytest.approx(3.0, abs=0.1)

    assert len(seen["stopped"]) == 1
    assert seen["stopped"].pop() < 3.0
    assert result.log.inserted_length[-1] == pytest.approx(0.007, abs=3e-4)
    assert 1.0 < result.log.time[-1] < 59
    again = run(load_scenario(tmp_path / "scenario.yaml")).log
    for name in ("needle_points", "X_WT", "X_WP"):
        np.testing.assert_allclose(
            getattr(again, name), getattr(result.log, name)[: len(again.time)], rtol=0, atol=1e-9
        )
