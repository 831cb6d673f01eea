"""The console without a browser: what it sends, to whom, and what it makes of what pages say."""

import gc
import json
import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from live_items import wait_until
from page_clients.console_socket import open_console, pull_console

from sonoservo.systems.display import Console
from sonoservo.systems.display.console import console as console_module
from sonoservo.systems.display.console.controls import controller_controls
from sonoservo.systems.display.console.readings import Sample


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def ramp(p_P):
    return 100 + 1000 * p_P[..., 0]


@pytest.fixture
def console():
    with closing(Console()) as console:
        yield console


def on_the_site(console, function=lambda: None):
    return console._site.ask(function)


class Page:
    """A page that speaks by Bokeh's client, and the document that the console keeps for it."""

    def __init__(self, console, *, draws=True):
        before = set(console._views)
        self._session = pull_console(console.web_url)
        (self._view,) = console._views - before
        (holder,) = (root for root in self._session.document.roots if root.name == "mode")
        _, _, self._order, self._drawn = holder.tags
        self.strips, self.pictures = {}, []
        self._view._page.on_change("state", self._receive)
        self._receive()
        if draws:
            self.has_drawn(10**6)  # whatever comes

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._session.close()

    def _said(self, name):
        return self._view._page.models[name].tags

    def _receive(self):
        """Keep strips and images as the page's script does."""
        words, *images = self._said("state")
        message = json.loads(words)
        if "strips" in message:
            strips = message["strips"]
            before = {} if strips["anew"] else self.strips
            self.strips = {
                name: [*before.get(name, []), *each][-strips["keep"] :]
                for name, each in strips["columns"].items()
            }
        if "frame" in message:
            left = iter(images)
            self.pictures = [each and next(left) for each in message["frame"]["pictures"]]

    @property
    def state(self):
        """What the console has sent last."""
        return json.loads(self._said("state")[0])

    def reading(self, name):
        """A reading as the page shows it."""
        return {each: value for each, _, value, _ in self.state["readings"]}[name]

    @property
    def described(self):
        return json.loads(self._said("described")[0])

    def has_drawn(self, number):
        self._drawn.tags = [number]
        self._session.force_roundtrip()

    def say(self, **order):
        self.say_raw([order])

    def say_raw(self, tags):
        self._order.tags = tags
        self._session.force_roundtrip()


def test_nothing_is_drawn_for_nobody_and_no_garbage_is_collected_meanwhile(
    console, make_volume, monkeypatch
):
    drawn = []
    monkeypatch.setattr(
        console_module, "slice_pictures", lambda *_: drawn.append(gc.isenabled()) or []
    )
    for k in range(5):
        console.show(make_volume(zeros, time=k))
    on_the_site(console)
    assert drawn == []
    with open_console(console.web_url):
        console.show(make_volume(zeros, time=6))
        wait_until(lambda: drawn)
    assert drawn[-1] is False
    wait_until(gc.isenabled)


def test_a_page_is_sent_the_newest_once_it_has_drawn_the_last(console, make_volume):
    with Page(console, draws=False) as page:
        page.has_drawn(page.state["number"])
        console.show_volume(make_volume(ramp, time=1.0))
        wait_until(lambda: page.state.get("volume") == 1)
        shown = page.state["number"]
        for k in range(2, 9):
            console.show_volume(make_volume(ramp, time=k))
        time.sleep(0.3)
        assert page.state["number"] == shown  # it has not said that it has drawn it
        page.has_drawn(shown)
        wait_until(lambda: page.state.get("volume") == 8)
        assert page.state["number"] == shown + 1


def test_a_late_page_gets_all_of_it(console, make_volume):
    for k in range(9):
        console.add(Sample(time=k / 8, mode="tracking", x=float(k)))
    console.show_volume(make_volume(ramp), None, 42)
    on_the_site(console)
    with Page(console) as page:
        assert page.state["volume"] == 42
        assert page.reading("x") == "8.0"
        assert page.strips["x"] == list(range(9))
        image, _ = page.pictures
        assert image.dtype == np.uint8
        assert image.max() > 100
        console.add(Sample(time=9 / 8, mode="tracking", x=9.0))
        wait_until(lambda: page.reading("x") == "9.0")
        assert page.strips["x"] == list(range(10))
        console.add(Sample(time=0.0, mode="lost", x=-1.0))  # a new run
        wait_until(lambda: page.reading("x") == "−1.0")
        assert page.strips["x"] == [-1.0]
        assert page.strips["begin"] == [-0.5]


def test_pages_share_the_controls(console):
    console.controls.offer(controller_controls(gain=1.6, force=2.0, min_force=0.5))
    console.controls.offer_buttons("pause", "stop", speed=1.0)
    with Page(console) as first, Page(console) as second:
        first.say(set="gain", value=0.7)
        wait_until(lambda: second.state["values"]["gain"] == 0.7)
        second.say(press="stop")
        second.say(speed=0.25)
        assert console.controls.pressed() == {"stop"}
        assert console.controls.speed == 0.25
        assert [each["name"] for each in first.described["sliders"]] == ["gain", "force"]


def test_what_a_page_says_amiss_is_ignored(console, make_volume):
    console.controls.offer(controller_controls(gain=1.6, force=2.0, min_force=0.5))
    console.show(make_volume(ramp))
    with Page(console) as page:
        for order in (
            {"press": 7},
            {"set": ["gain"], "value": 1},
            {"set": "gain", "value": "all"},
            {"offsets": [None, {}]},
            {"offsets": [1e300, -1e300]},
            {"cine": True},
            {"axes": {"x": 1}},
            {},
        ):
            page.say(**order)
        for tags in ([], ["order"], [[1]], [None]):
            page.say_raw(tags)
        assert console.controls.shown[1] == {"gain": 1.6, "force": 2.0}
        assert console.controls.pressed() == set()
        wait_until(lambda: page.state["offsets"] == [200.0, -200.0])


def test_a_page_goes_back_and_beside_alone(console, make_volume):
    with Page(console) as page, Page(console) as other:
        for k in range(1, 4):
            console.show(make_volume(ramp, time=float(k)))
            wait_until(lambda k=k: page.state.get("volume") == k)
        page.say(cine=1.2)
        wait_until(lambda: page.state["volume"] == 1)
        assert page.state["live"] is False
        assert other.state["volume"] == 3
        page.say(cine=None, offsets=[5, 0])
        wait_until(lambda: page.state["volume"] == 3)
        assert page.state["offsets"] == [5.0, 0.0]
        page.say(offsets=[200, 0])  # beside the volume
        wait_until(lambda: page.pictures[0] is None)
        assert page.pictures[1] is not None


def test_nothing_is_left_behind_by_a_process_that_ends(make_volume):
    count = threading.active_count()
    console = Console()
    assert threading.active_count() == count + 1
    console.close()
    console.close()
    assert threading.active_count() == count
    console.show(make_volume(zeros))  # it goes on unseen
    console.say(note="over")
    program = (
        "from sonoservo.systems.display.console.console import Console; print(Console().web_url)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("http://localhost:")
