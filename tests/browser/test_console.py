"""The console in a browser: what is where, that it is the newest, and what fits."""

import re
from contextlib import closing

import numpy as np
import pytest
from page_clients.browser_view import eventually, screenshot
from playwright.sync_api import expect
from synthetic_volumes import ENTRY, Scene

from sonoservo.systems.display import Console, Site
from sonoservo.systems.display.colours import MODE_COLOURS
from sonoservo.systems.display.console.controls import controller_controls, operator_controls
from sonoservo.systems.display.console.readings import Frame, Reading, Sample
from sonoservo.systems.display.console.shape_page import PATHS, ShapePage
from sonoservo.systems.display.console.slices import SlicePicture, slice_pictures
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

TIPS = [ENTRY + np.array([0.045, 0.010, 0.004]), ENTRY + np.array([0.070, 0.014, 0.010])]
SIZES = [(1024, 768), (768, 1024)]
SEARCHING = "nothing changed by more than 3.0 dB"


@pytest.fixture(scope="module")
def shown():
    """Two volumes with a needle, and the estimate in each."""
    scene = Scene(seed=3)
    volumes = [
        scene.volume(2 * k, lambda time, tip=tip: (ENTRY, tip)) for k, tip in enumerate(TIPS)
    ]
    return [
        (volume, NeedleEstimate(TrackingMode.TRACKING, volume.time, NeedleCurve([ENTRY, tip]),
                                np.zeros((2, 3)), np.eye(12), volume.time))
        for volume, tip in zip(volumes, TIPS, strict=True)
    ]  # fmt: skip


@pytest.fixture
def console():
    """A console without a view of the world or the probe, which a browser draws in software."""
    with closing(Console(title="a test", world=None)) as console:
        yield console


@pytest.fixture
def whole_console():
    """A console with everything."""
    with closing(Console(title="a test")) as console:
        yield console


PIXELS = """
([number, points]) => {
  const plot = Bokeh.documents[0].get_model_by_name(`slice_${number}`);
  const view = Bokeh.index.find_one(plot) ?? Object.values(Bokeh.index)[0];
  const box = view.el.getBoundingClientRect(), frame = view.frame.bbox;
  return points.map(([x, y]) => [
    box.x + frame.left + (x - plot.x_range.start) / (plot.x_range.end - plot.x_range.start)
      * frame.width,
    box.y + frame.top + (y - plot.y_range.end) / (plot.y_range.start - plot.y_range.end)
      * frame.height]);
}
"""


def pixels(page, number, points):
    """(m, 2) columns and rows of (m, 2) points of a slice, in mm."""
    return np.array(page.evaluate(PIXELS, [number, np.asarray(points).tolist()]))


def near_colour(picture, colour):
    """(rows, columns) whether a picture has about a colour there."""
    near = [
        np.abs(picture[..., k].astype(np.int16) - round(255 * colour[k])) < 60 for k in range(3)
    ]
    return np.logical_and.reduce(near)


def has_colour(near, points, reach=2):
    """(m,) whether there is a colour near (m, 2) pixels."""
    at = np.rint(points).astype(int)
    return [near[y - reach : y + reach + 1, x - reach : x + reach + 1].any() for x, y in at]


def check_needle(page, volume, estimate):
    """Rails and ring are beside the needle's echo on both slices, and never on it."""
    near = near_colour(screenshot(page), MODE_COLOURS[estimate.mode])
    for number, shown in enumerate(slice_pictures(volume, estimate.curve)):
        middle = 0.5 * (shown.rails[0] + shown.rails[1])
        turns = np.linspace(0, 2 * np.pi, 8)
        ring = shown.tip + 2.5 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        beside, on = [*(rail[2:-3] for rail in shown.rails), ring], [middle[2:-4], [shown.tip]]
        assert all(has_colour(near, pixels(page, number, np.concatenate(beside))))
        assert not any(has_colour(near, pixels(page, number, np.concatenate(on)), 0))


def show(console, volume, estimate, **values):
    console.show(volume, estimate, force=2.0, error=0.4, **values)


def test_the_needle_is_beside_its_echo_and_can_be_switched_off(open_page, console, shown):
    page = open_page(console.web_url)
    expect(page.locator("#word")).to_have_text("waiting", ignore_case=True)
    expect(page.locator("#detail")).to_contain_text("waiting for the first volume")
    for volume, estimate in shown:
        show(console, volume, estimate)
        eventually(page, lambda v=volume, e=estimate: check_needle(page, v, e))
    page.keyboard.press("n")

    def check_off():
        with pytest.raises(AssertionError):
            check_needle(page, *shown[1])

    eventually(page, check_off)
    page.click("#overlay")
    eventually(page, lambda: check_needle(page, *shown[1]))
    # A millimetre is as long to the right as down, and on both slices.
    right, down, other = (
        np.diff(pixels(page, number, points), axis=0)[0]
        for number, points in (
            (0, [[0, 0], [10, 0]]),
            (0, [[0, 0], [0, 10]]),
            (1, [[0, 0], [10, 0]]),
        )
    )
    assert right[0] == pytest.approx(down[1], rel=0.01)
    assert right[0] == pytest.approx(other[0], rel=0.06)


SHAPE = """
() => [...document.getElementById('mark').children]
  .filter(each => each.style.display != 'none').map(each => each.outerHTML.slice(0, 40)).join()
"""
PARTS = (
    "#world", ".slice", ".strip:not([hidden])", "#controls", "#readings", "#view",
    "#buttons button", "#sliders label", "#sliders kbd", "header button",
)  # fmt: skip


def test_every_state_has_its_word_shape_and_colour_and_all_of_it_fits(
    open_page, whole_console, shown
):
    console = whole_console
    console.controls.offer(
        [
            *operator_controls(azimuth_deg=10, dip_deg=5),
            *controller_controls(gain=1.6, force=2.0, min_force=0.5),
        ]
    )
    console.controls.offer_buttons("pause", "restart", "save", "finish")
    page = open_page(console.web_url)
    show(console, *shown[0])
    shapes = set()
    for number, mode in enumerate(TrackingMode):
        reason = SEARCHING if mode == TrackingMode.SEARCHING else ""
        console.add(Sample(time=10.0 + number, mode=str(mode), reason=reason, held="by a hand"))
        page.wait_for_function(
            "word => document.getElementById('word').textContent == word", arg=str(mode)
        )
        shapes.add(page.evaluate(SHAPE))
        colour = page.evaluate("getComputedStyle(document.getElementById('word')).color")
        rgb = [int(each) for each in colour.removeprefix("rgb(").removesuffix(")").split(",")]
        np.testing.assert_allclose(rgb, 255 * np.array(MODE_COLOURS[mode]), atol=1)
    assert len(shapes) == 4
    console.add(Sample(time=15.0, mode="tracking", stopped="the force is above 6 N"))
    page.wait_for_selector("#state[data-kind=stopped]")
    expect(page.locator("#detail")).to_contain_text("the force is above 6 N")
    for size in SIZES:
        page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
        eventually(page, lambda size=size: check_fits(page, *size))


def check_fits(page, width, height):
    whole = page.evaluate("(({scrollWidth: x, scrollHeight: y}) => [x, y])(document.body)")
    assert whole == [width, height]
    for selector in PARTS:
        for part in page.query_selector_all(selector):
            box = part.bounding_box()
            assert min(box["width"], box["height"]) > 8, selector
            assert min(box["x"], box["y"]) >= 0, selector
            assert box["x"] + box["width"] <= width, selector
            assert box["y"] + box["height"] <= height, selector
    for part in page.query_selector_all(".slice .plot"):
        assert min(part.bounding_box()[side] for side in ("width", "height")) > 100


def test_gain_window_planes_and_cine(open_page, console, shown):
    page = open_page(console.web_url)
    for k, (volume, estimate) in enumerate(shown):
        show(console, volume, estimate, number=k + 1)
        eventually(page, lambda v=volume, e=estimate: check_needle(page, v, e))
    low_high = "(({low, high}) => [low, high])(Bokeh.documents[0].get_model_by_name('grey'))"
    eventually(page, lambda: check_equal(page.evaluate(low_high), [0, 255]))
    page.locator("#view-gain").fill("10")
    page.locator("#view-window").fill("30")
    high = 255 - 10 * 255 / 60
    wanted = pytest.approx([high - 30 * 255 / 60, high])
    eventually(page, lambda: check_equal(page.evaluate(low_high), wanted))
    box = page.locator(".slice").first.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    for _ in range(3):
        page.mouse.wheel(0, 100)
    page.wait_for_function("document.querySelector('.offset').textContent == '+3 mm beside it'")
    rails = (
        "Bokeh.documents[0].get_model_by_name('slice_0').renderers[1].data_source.data.xs.length"
    )
    page.wait_for_function(f"{rails} == 0")
    page.click("#centre")
    page.wait_for_function(f"{rails} == 2")
    page.locator("#cine").fill("0")
    eventually(page, lambda: check_needle(page, *shown[0]))
    expect(page.locator("#cine + output")).to_have_text(re.compile("^−"))
    page.click("#live")
    eventually(page, lambda: check_needle(page, *shown[1]))


def test_keys_by_mistake_move_nothing_and_space_pauses_without_scrolling(open_page, console):
    console.controls.offer(operator_controls(azimuth_deg=10, dip_deg=5))
    console.controls.offer_buttons("pause", "restart", "save", "finish")
    page = open_page(console.web_url)
    start = console.controls.shown[1]
    for key in ("w", "w", "d", "l", "r", "v", "f", "x", "Enter", "ArrowDown", "Control+w", "1"):
        page.keyboard.press(key)
    page.keyboard.press("Space")
    eventually(page, lambda: check_pressed(console, {"pause"}))
    assert console.controls.shown[1] == start
    assert page.evaluate("[scrollX, scrollY]") == [0, 0]
    page.keyboard.press("?")
    for text in ("pause or go on", "needle in, by 1 mm", "gamepad"):
        expect(page.locator("#help")).to_contain_text(text)
    expect(page.locator("#help")).to_be_visible()
    page.keyboard.press("w")
    page.keyboard.press("Escape")
    page.click("#arm")
    page.keyboard.press("w")
    page.keyboard.press("Control+w")
    page.keyboard.press("v")
    eventually(page, lambda: check_pressed(console, {"save"}))
    assert console.controls.shown[1] == start | {"depth": 1.0}


def check_pressed(console, wanted):
    """Presses add up until they are as wanted."""
    for button in console.controls.pressed():
        wanted = wanted - {button}
    assert not wanted


@pytest.mark.slow
def test_a_page_says_when_its_server_ends_and_goes_on_with_the_next(open_page, shown, monkeypatch):
    port = 8640  # no other test looks here
    with Site(port=port) as site:
        console = Console(site, world=None)
        page = open_page(console.web_url)
        show(console, *shown[0])
        eventually(page, lambda: check_needle(page, *shown[0]))
        expect(page.locator("#gone")).to_be_hidden()
    page.wait_for_selector("#gone", state="visible")
    check_needle(page, *shown[0])  # the last picture stays
    with Site(port=port) as site:
        following = Console(site, world=None)
        assert following.web_url == console.web_url
        following.controls.offer_buttons("stop")
        page.wait_for_selector("#buttons [data-name=stop]")  # it has loaded itself anew
        expect(page.locator("#gone")).to_be_hidden()
        page.close()


def test_the_end_links_the_report_and_leaves_the_page_usable(open_page, console, shown):
    console.controls.offer_buttons("pause", "step", "stop", speed=1.0)
    page = open_page(console.web_url)
    show(console, *shown[0])
    page.click("[data-name=stop]")
    expect(page.locator("[data-name=stop]")).to_have_text("really stop?")
    assert console.controls.pressed() == set()
    page.wait_for_function("document.querySelector('[data-name=stop]').textContent == 'stop'")
    page.evaluate("for (const _ of [0, 1]) document.querySelector('[data-name=stop]').click()")
    eventually(page, lambda: check_pressed(console, {"stop"}))
    page.select_option("#speed", "0.25")
    eventually(page, lambda: check_equal(console.controls.speed, 0.25))
    console.controls.offer_buttons()
    console.say(ended="32.0 s simulated", report="../report/report.html")
    report = re.compile(r"^\.\./report/report\.html\?token=")
    expect(page.locator("#report")).to_have_attribute("href", report)
    expect(page.locator("#word")).to_have_text("ended", ignore_case=True)
    page.locator("#view-gain").fill("5")
    expect(page.locator("#view-gain + output")).to_have_text("5 dB")


def test_a_shape_prediction_has_a_slice_charts_and_figures_of_its_own(open_page, console):
    ShapePage(console=console, depth=0.1).start()
    path = {name: [0.0, 1.0, 4.0] for name in PATHS} | {"depth": [0.0, 50.0, 100.0]}
    seen = {"found_depth": [0.0, 50.0], "found_x": [0.1, 0.9], "found_y": [0.0, 1.1],
            "true_depth": [0.0, 50.0], "true_x": [0.0, 1.0], "true_y": [0.0, 1.0]}  # fmt: skip
    grey, ring = np.full((40, 30), 90, np.uint8), np.array([1.0, 9.0])
    edges = (-15.0, 15.0, 0.0, 40.0)
    picture = SlicePicture(
        "Axial slice", ("X", "depth"), grey, (-15.0, 0.0), (30.0, 40.0), edges, [], ring
    )
    page = open_page(console.web_url)
    console.show_frame(Frame(1, 0.5, "tracking", [picture], 60 / 255, path | seen))
    console.add(Sample(time=0.5, error=0.2, readings=[Reading("bend", "true bend", 4.0, "mm")]))
    expect(page.locator("#readings")).to_contain_text("true bend")
    expect(page.locator("#readings")).to_contain_text("4.0")
    expect(page.locator("[data-slice='1']")).to_be_hidden()
    chart = "Bokeh.documents[0].get_model_by_name('chart_x')"
    for words, wanted in (
        ("[...document.querySelectorAll('.strip:not([hidden])')].map(each => each.id)",
         ["strip-chart_x", "strip-chart_y", "strip-error"]),
        (f"{chart}.x_range.end", 100),
        (f"{chart}.renderers.map(each => each.data_source.data.depth.length)", [3, 3, 2, 2]),
    ):  # fmt: skip
        eventually(page, lambda w=words, v=wanted: check_equal(page.evaluate(w), v))


def check_equal(first, second):
    assert first == second
