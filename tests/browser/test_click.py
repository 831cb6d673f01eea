"""A person clicks on the needle in the first slice, and the tracker starts there."""

import io
import queue
import threading

import numpy as np
import pytest
from playwright.sync_api import expect
from rich.console import Console as Terminal

from sonoservo.diagrams import load_scenario, make_experiment, run
from sonoservo.diagrams.app.options import Page
from sonoservo.diagrams.app.pages import first_click
from sonoservo.diagrams.app.pages.first_click import ask_click, first_slice
from sonoservo.systems.files.refusals import ConfigurationError

SHORT = {"depth": 0.02, "observe_until": 0.01, "rotations": [], "step": 2e-3}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("carriere2016_d60", changes=SHORT, seed=100)


def click(page, image, p_P):
    """Click at a position in P, in m."""
    low = image.position((-0.5, -0.5))
    size = image.spacing * image.intensities.shape
    box = page.locator("#picture image").bounding_box()
    u, v = (np.asarray(p_P) - low) / size
    page.mouse.click(box["x"] + u * box["width"], box["y"] + v * box["height"])


def test_a_run_starts_where_somebody_clicked(scenario, open_page, tmp_path, monkeypatch):
    addresses, clicked = queue.Queue(), queue.Queue()
    monkeypatch.setattr(
        first_click, "announce", lambda terminal, words, address, page: addresses.put(address)
    )
    terminal = Terminal(file=io.StringIO())
    threading.Thread(
        target=lambda: clicked.put(ask_click(scenario, terminal, Page())), daemon=True
    ).start()
    page = open_page(addresses.get(timeout=120))
    image = first_slice(scenario)
    place = make_experiment(scenario).true_path(np.zeros(1))[0, :2] + np.array([0.4e-3, -0.3e-3])

    click(page, image, [0.0, -1.5e-3])  # above the slice, in the picture's margin
    page.wait_for_timeout(300)
    assert clicked.empty()
    expect(page.locator("#where")).to_contain_text("across the needle")
    click(page, image, place)
    page.wait_for_function("document.querySelector('#where').textContent.includes('goes on')")
    started = clicked.get(timeout=30)
    np.testing.assert_allclose(started.tracker.start, place, atol=0.1e-3)  # a pixel of the screen

    result = run(started, out=tmp_path)
    first = np.flatnonzero(np.isfinite(result.log.measured[:, 0]))[0]
    error = result.log.measured[first, :2] - result.log.true[first, :2]
    assert np.linalg.norm(error) < 0.5e-3
    again = load_scenario(tmp_path / "scenario.yaml")
    assert again.tracker.start == started.tracker.start


def test_the_slice_is_the_first_that_arrives():
    changes = {**SHORT, "scanner.connection.lost_sweeps": 0.6}
    scenario = load_scenario("carriere2016_d60", changes=changes, seed=101)
    experiment = make_experiment(scenario)
    seen = []
    experiment.run(lambda each: seen.append(each.evaluate(each.slice_converter, "slice")))
    assert len(seen) < 11
    image = first_slice(scenario)
    np.testing.assert_array_equal(image.intensities, seen[0].intensities)
    assert image.time == seen[0].time


def test_a_scanner_that_loses_every_slice_leaves_nothing_to_click_on(scenario):
    lost = load_scenario(
        "carriere2016_d60", changes={**SHORT, "scanner.connection.lost_sweeps": 0.999}, seed=100
    )
    with pytest.raises(ConfigurationError, match="the scanner loses all of them"):
        first_slice(lost)
