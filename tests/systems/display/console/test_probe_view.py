import base64
import io

import numpy as np
import pytest
from meshcat import Visualizer
from PIL import Image

from sonoservo.systems.display.colours import MODE_COLOURS
from sonoservo.systems.display.console.probe_view import ProbeView
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

ENTRY, TIP = np.array([-0.03, 0.03, -0.02]), np.array([0.01, 0.05, 0.01])


class Recorder:
    """Takes the place of meshcat's window: keeps what it was sent last, and counts."""

    def __init__(self):
        self.kept, self.paths = {}, []

    def send(self, command):
        data = command.lower()
        path = data["path"].removeprefix("/meshcat/probe")
        self.kept[data["type"], path] = data
        self.paths.append(path)

    def vertices(self, path):
        (geometry,) = self.kept["set_object", path]["object"]["geometries"]
        packed = geometry["data"]["attributes"]["position"]["array"].data
        return np.frombuffer(packed, "<f4").reshape(-1, 3).astype(float)

    def colour(self, path):
        return self.kept["set_object", path]["object"]["materials"][0]["color"]

    def visible(self, path):
        return self.kept["set_property", path]["value"]

    def brightest(self, path):
        """Where in P a picture is brightest, as three.js draws it on its rectangle."""
        sent = self.kept["set_object", path]["object"]
        url = sent["images"][0]["url"]
        grey = np.array(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))))[..., 0]
        grey = grey.astype(float) ** 2
        rows, columns = grey.shape
        right = (grey.sum(axis=0) @ (np.arange(columns) + 0.5)) / grey.sum() / columns - 0.5
        down = (grey.sum(axis=1) @ (np.arange(rows) + 0.5)) / grey.sum() / rows - 0.5
        (size,) = sent["geometries"]
        X = np.reshape(self.kept["set_transform", path]["matrix"], (4, 4)).T
        return (X @ [right * size["width"], -down * size["height"], 0, 1])[:3]


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def view(recorder):
    return ProbeView(Visualizer(window=recorder))


def ball_at_the_tip(p_P):
    return 200 * np.exp(-np.sum((p_P - TIP) ** 2, axis=-1) / (2 * 0.003**2))


def estimate(volume, mode=TrackingMode.TRACKING, points=(ENTRY, TIP)):
    curve = NeedleCurve(points).transformed(volume.X_WP)
    n = len(points)
    return NeedleEstimate(mode, volume.time, curve, np.zeros((n, 3)), np.eye(6 * n), volume.time)


def test_slices_and_needle_are_where_they_are_in_the_probe(view, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    view.draw(volume, estimate(volume))
    for path in ("/slice_0", "/slice_1"):
        np.testing.assert_allclose(recorder.brightest(path), TIP, atol=0.3e-3)
    needle = recorder.vertices("/needle")
    along = (TIP - ENTRY) / np.linalg.norm(TIP - ENTRY)
    off = np.linalg.norm(np.cross(needle - ENTRY, along), axis=1)
    np.testing.assert_allclose(off, 0.9e-3, atol=1e-5)
    assert (needle @ along).max() == pytest.approx(TIP @ along, abs=1e-5)


@pytest.mark.parametrize("mode", list(TrackingMode)[1:])
def test_the_colour_tells_the_mode(view, recorder, make_volume, mode):
    volume = make_volume(ball_at_the_tip)
    view.draw(volume, estimate(volume, mode))
    red, green, blue = (round(255 * each) for each in MODE_COLOURS[mode])
    assert recorder.colour("/needle") == red << 16 | green << 8 | blue


def test_the_needle_goes_when_it_is_lost_from_view(view, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    view.draw(volume, estimate(volume))
    assert recorder.visible("/needle")
    view.draw(volume, NeedleEstimate(TrackingMode.SEARCHING, 0.0))
    assert recorder.visible("/slice_1")
    assert not recorder.visible("/needle")
    view.draw(volume, estimate(volume, points=(ENTRY + 1.0, TIP + 1.0)))
    assert not recorder.visible("/slice_1")  # its plane misses the volume


def test_the_outline_is_that_of_the_sector_or_else_of_the_grid(view, recorder, make_volume):
    volume = make_volume(ball_at_the_tip, motion=False)
    view.draw(volume, None)
    edges = recorder.vertices("/outline")
    np.testing.assert_allclose(edges.min(axis=0), volume.origin, atol=1e-7)
    np.testing.assert_allclose(edges.max(axis=0), volume.upper, atol=1e-7)
    assert len(edges) == 24
    recorder.paths.clear()
    view.draw(volume, None)
    assert "/outline" not in recorder.paths  # it has not changed
    view.draw(make_volume(ball_at_the_tip), None)
    assert len(recorder.vertices("/outline")) > 24
