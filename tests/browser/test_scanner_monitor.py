"""The scanner's monitor in a browser: what is where, and that it is the newest."""

from contextlib import closing

import numpy as np
import pytest
from page_clients.browser_view import eventually, project, screenshot, still
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.display.monitor.monitor import Monitor
from sonoservo.systems.display.monitor.views import monitor_views
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

ENTRY = entry_on_side()
TIPS = [ENTRY + np.array([0.045, 0.010, 0.004]), ENTRY + np.array([0.070, 0.014, 0.010])]


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
def monitor():
    with closing(Monitor()) as monitor:
        yield monitor


def pixels(page, points):
    """(m, 2) columns and rows of (m, 2) points of the screen, X right and Y down."""
    return project(page, [[x, 0.0, -y] for x, y in points])


def is_red(picture):
    picture = picture.astype(int)
    return (picture[..., 0] > 130) & (picture[..., 1:].max(axis=-1) < 100)


def red_at(page, picture, points):
    """(m,) whether there is red within a pixel of (m, 2) points of the screen."""
    at = np.rint(pixels(page, points)).astype(int)
    red = is_red(picture)
    return [red[row - 1 : row + 2, column - 1 : column + 2].any() for column, row in at]


def check_needle(page, picture, volume, estimate):
    """The needle is on both pictures, and nothing beside it; its ring surrounds the tip."""
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    for view in monitor_views(volume, estimate.curve):
        entry, tip = view.coordinates([estimate.curve.entry, estimate.curve.tip])
        assert all(red_at(page, picture, view.on_screen(tip + 0.0025 * circle)))
        assert not any(red_at(page, picture, view.on_screen(np.add(tip, [[0, 0], [0.008, 0]]))))
        assert not any(red_at(page, picture, view.on_screen(tip + 0.006 * circle[:5])))
        along = entry + np.linspace(0.05, 0.9, 9)[:, np.newaxis] * (tip - entry)
        assert all(red_at(page, picture, view.on_screen(along)))
        beside = view.on_screen(np.add(along, [0, 0.004]))
        assert not any(red_at(page, picture, beside))


def drawn(page, volume, estimate):
    """A screenshot, when a volume has been drawn."""
    eventually(page, lambda: check_needle(page, screenshot(page), volume, estimate))
    return still(page)


def test_needle_and_ring_are_on_both_pictures(open_page, monitor, shown):
    page = open_page(monitor.web_url)
    assert page.is_visible("text=waiting for the first volume")
    for number, (volume, estimate) in enumerate(shown):
        monitor.show(volume, estimate, number + 1)
        drawn(page, volume, estimate)
        assert not page.is_visible("text=waiting for the first volume")


def test_a_tick_each_10_mm_below_and_beside_each_picture(open_page, monitor, shown):
    page = open_page(monitor.web_url)
    volume, estimate = shown[0]
    monitor.show(volume, estimate)
    picture = drawn(page, volume, estimate).max(axis=2)
    for view in monitor_views(volume, estimate.curve):
        low, high = view.window
        for axis in (0, 1):
            at = 0.01 * np.arange(np.ceil(low[axis] / 0.01), np.floor(high[axis] / 0.01) + 1)
            assert len(at) >= 9
            ticks = np.tile([low[0], high[1]] if axis == 0 else low, (len(at), 1))
            ticks[:, axis] = at
            # 4 thousandths of the screen outside the picture, where the scale has ticks alone.
            outside = [0, 0.004] if axis == 0 else [-0.004, 0]
            for point in np.rint(pixels(page, view.on_screen(ticks) + outside)).astype(int):
                column, row = point
                around = picture[row - 6 : row + 7, column - 6 : column + 7]
                line = around[6] if axis == 0 else around[:, 6]
                assert abs(np.argmax(line) - 6) <= 1
                assert line.max() > line[[0, -1]].max() + 40


def test_every_page_shows_the_newest_volume(open_page, monitor, shown):
    first = open_page(monitor.web_url)
    monitor.show(*shown[0], 1)
    earlier = drawn(first, *shown[0])
    second = open_page(monitor.web_url)  # opened late
    np.testing.assert_allclose(drawn(second, *shown[0]), earlier, atol=3)
    first.close()
    monitor.show(*shown[1], 2)
    later = drawn(second, *shown[1])
    second.reload()
    second.wait_for_function("typeof viewer !== 'undefined' && viewer.renderer")
    np.testing.assert_allclose(drawn(second, *shown[1]), later, atol=3)


def test_a_page_says_when_its_monitor_ends_and_goes_on_with_the_next(open_page, shown):
    port = 8640  # no other test looks here
    with Site(port=port) as site:
        monitor = Monitor(site)
        page = open_page(monitor.web_url)
        monitor.show(*shown[0])
        drawn(page, *shown[0])
        assert not page.is_visible("#stopped")
    with Site(port=port) as site:
        following = Monitor(site)
        assert following.web_url == monitor.web_url
        page.wait_for_selector("#stopped", state="visible")
        following.show(*shown[1])
        page.wait_for_selector("#stopped", state="hidden")
        drawn(page, *shown[1])
        page.close()


def test_nothing_piles_up_in_a_page(open_page, monitor, shown):
    page = open_page(monitor.web_url)
    count = "[viewer.renderer.info.memory.textures, viewer.renderer.info.memory.geometries]"
    monitor.show(*shown[0])
    drawn(page, *shown[0])
    early = page.evaluate(count)
    for number in range(40):
        monitor.show(*shown[number % 2])
        page.wait_for_timeout(25)
    drawn(page, *shown[1])  # the newest
    assert page.evaluate(count) == early


def test_the_document_shows_the_same(open_page, monitor, shown, tmp_path):
    page = open_page(monitor.web_url)
    monitor.show(*shown[0])
    live = drawn(page, *shown[0])
    kept = tmp_path / "monitor.html"
    kept.write_text(monitor.html())
    page = open_page(kept.as_uri())
    np.testing.assert_allclose(drawn(page, *shown[0]), live, atol=3)
