"""The world view in a browser: live, opened late, layer by layer, and as a replay."""

from time import monotonic

import numpy as np
import pytest
from page_clients.browser_view import eventually, project, screenshot, wait_for_object
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform

from sonoservo.diagrams import load_scenario, make_experiment
from sonoservo.systems.display import Console, Site, open_meshcat
from sonoservo.systems.display.pages.site import Files
from sonoservo.systems.evaluation.reports.report import save_replay

DURATION = 5.5
CHANGES = [
    f"duration={DURATION}",
    "hand.start=0.3",
    "hand.pushes=[{duration: 5, speed: 0.016}]",
    "station.plant.contact_model=point",
    "station.probe.height=0.004",
]
LAYERS = ["needle", "estimate", "uncertainty", "slices"]


class Run:
    """A short run in which a needle is found, and what was believed after each volume."""

    def __init__(self, meshcat):
        self.meshcat = meshcat
        scenario = load_scenario("chatelain2013_fig5", changes=CHANGES)
        experiment = make_experiment(scenario, meshcat=meshcat)
        meshcat.StartRecording(set_visualizations_while_recording=True)
        self.times, self.estimates = [], []

        def note(experiment):
            self.times.append(experiment.time)
            self.estimates.append(experiment.estimate)

        experiment.run(note)
        self.log = experiment.log()


@pytest.fixture(scope="module")
def run():
    with Site() as site:
        yield Run(open_meshcat(site))


@pytest.fixture(scope="module")
def replay(run, tmp_path_factory):
    """The last thing that is done with the run: its page plays the recording from then on."""
    return save_replay(run.meshcat, tmp_path_factory.mktemp("world") / "replay.html")


def open_world(open_page, url):
    """Open a page, and wait for what the view makes last at its start."""
    page = open_page(url)
    wait_for_object(page, "/force/arrow/head")
    return page


def patch(picture, point, size=3):
    column, row = np.rint(np.ravel(point)).astype(int)
    return picture[row - size : row + size + 1, column - size : column + size + 1].astype(int)


def is_orange(colours):
    return colours[..., 1] - colours[..., 2] > 60


def is_violet(colours):
    return np.minimum(colours[..., 0], colours[..., 2]) - colours[..., 1] > 50


def test_a_page_opened_late_shows_everything_and_each_layer_can_be_switched_off(run, open_page):
    page = open_world(open_page, run.meshcat.web_url())
    curve = run.estimates[-1].curve
    X_WP = RigidTransform(run.log.X_WP[-1])
    wait_for_object(page, "/needle/hub/0")

    def check():
        picture = screenshot(page)
        # What is stated of the tip covers the last quarter.
        for point in project(page, np.linspace(curve.entry, curve.tip, 9)[1:-2]):
            assert is_orange(patch(picture, point)).any()
        assert is_violet(patch(picture, project(page, curve.tip))).any()
        hub = "viewer.scene_tree.find(['needle', 'hub', '0']).object.position.toArray()"
        pink = patch(picture, project(page, page.evaluate(hub)))
        assert (pink[..., 0] - pink[..., 1] > 50).any()
        # Between the probe's face and the needle there is speckle.
        speckle = patch(picture, project(page, X_WP.multiply([0.0, 0.02, 0.0])), 8)
        assert speckle[..., 1].std() > 3

    eventually(page, check)
    page.get_by_text("Open Controls").click()
    covered = np.rint(page.get_by_text("Close Controls").bounding_box()["x"]).astype(int)

    def check_changed(name, before, visible):
        shown = f"viewer.scene_tree.children[{name!r}].object.visible"
        assert page.evaluate(shown) is visible, name
        changed = np.abs(screenshot(page)[:, :covered].astype(int) - before).max(-1) > 8
        assert changed.sum() > 3, name

    def switch(name, visible):
        row = page.get_by_text(name, exact=True).locator("xpath=../../..")
        before = screenshot(page)[:, :covered]
        row.locator("input[type=checkbox]").first.set_checked(visible)
        eventually(page, lambda: check_changed(name, before, visible))

    switch("phase", True)  # beside the view in the console, and in the replay from the start
    for name in LAYERS:
        switch(name, False)


SHOWN = """
names => names.map(name => {
  const node = viewer.scene_tree.find(name.split('/'));
  return Object.keys(node.children).filter(
    each => each != '<object>' && node.children[each].object.visible);
})
"""


def test_the_replay_plays_by_itself_in_step(run, replay, open_page):
    page = open_page(replay.as_uri())
    page.wait_for_function("viewer.animator.duration > 0 && viewer.animator.playing")
    assert page.evaluate("viewer.animator.duration") == pytest.approx(DURATION, abs=0.2)
    page.evaluate("viewer.animator.pause()")
    # A minute is below 20 MB: beside the viewer, the size depends on the time recorded alone.
    viewer = len(Meshcat(MeshcatParams(host="localhost")).StaticHtml())
    assert viewer + 60 * (replay.stat().st_size - viewer) / run.times[-1] < 20e6
    count = len(run.times)

    def check_tip(tip):
        assert is_violet(patch(screenshot(page), project(page, tip))).any()

    for number in (1, count // 2, count - 2):  # a moment before the next volume
        time = run.times[number + 1] - 0.05
        page.evaluate("time => viewer.animator.seek(time)", time)
        slices, phase, force = page.evaluate(SHOWN, ["slices", "phase", "force/value"])
        assert slices == [str(number)]
        assert set(phase) - {"reason"} == {run.estimates[number].mode}
        logged = np.interp(time, run.log.time, run.log.contact_force)
        value = float(force[0].removesuffix(" N")) if force else 0.0
        assert value == pytest.approx(logged, abs=0.15)
        if run.estimates[number]:
            tip = run.estimates[number].curve.tip
            eventually(page, lambda tip=tip: check_tip(tip))
        # The probe is where it was: its face, in the arm's own chain of poses.
        p_WP = np.array([np.interp(time, run.log.time, axis) for axis in run.log.X_WP[:, :3, 3].T])
        face = "viewer.scene_tree.find(['probe', 'probe']).object.position.toArray()"
        np.testing.assert_allclose(page.evaluate(face), p_WP, atol=5e-4)


@pytest.mark.slow
def test_the_console_winds_the_world_of_a_kept_run(replay, open_page):
    with Site() as site:
        site.add("report", "Report", [("(.*)", Files, {"path": str(replay.parent)})])
        console = Console(site, world="report/replay.html")
        page = open_page(console.web_url)
        animator = "document.querySelector('#world iframe').contentWindow.viewer?.animator"
        page.wait_for_function(f"{animator}?.duration > 0")
        for time in (2.0, 1.0):
            console.say(seek=time, without=["slices", "strips"])
            page.wait_for_function(
                f"time => {animator}.actions.every(each => each.time <= time) && "
                f"{animator}.actions.some(each => each.time == time)",
                arg=time,
            )
        assert not page.evaluate(f"{animator}.playing")
        page.close()


def test_a_run_has_not_ended_for_its_page_before_the_world_shows_the_end(open_page):
    with Site() as site:
        meshcat = open_meshcat(site)
        console = Console(site, world="world")
        meshcat.StartRecording()
        for time in (0.0, 2.0):
            meshcat.SetTransform("needle", RigidTransform([0, 0, time]), time)
        page = open_page(console.web_url)
        console.say(ended="2.0 s simulated")
        page.wait_for_function("document.getElementById('word').textContent == 'ended'")
        start = monotonic()
        console.wait_until_shown(0.5)
        assert monotonic() - start >= 0.5
        meshcat.StopRecording()
        meshcat.PublishRecording()
        console.wait_until_shown(60.0)
        assert monotonic() - start < 60.0
        world = "document.querySelector('#world iframe').contentWindow.viewer"
        assert page.evaluate(f"{world}.scene_tree.find(['drake', 'needle']).object.position.z") == 2
        page.close()
