import base64
import io

import numpy as np
import pytest
from meshcat import Visualizer
from PIL import Image

from sonoservo.systems.display.monitor.drawing import MonitorScreen, readings
from sonoservo.systems.display.monitor.lettering import PIXELS, line_image, scale_image
from sonoservo.systems.display.world.needle_view import MODE_COLOURS
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

ENTRY, TIP = np.array([-0.03, 0.03, -0.02]), np.array([0.01, 0.05, 0.01])
PLACES = ("screen", "probe")


class Recorder:
    """Takes the place of meshcat's window: keeps what it was sent last, and counts."""

    def __init__(self):
        self.kept, self.paths = {}, []

    def send(self, command):
        data = command.lower()
        path = data["path"].removeprefix("/meshcat/monitor/")
        self.kept[data["type"], path] = data
        self.paths.append(path)

    def vertices(self, path):
        (geometry,) = self.kept["set_object", path]["object"]["geometries"]
        packed = geometry["data"]["attributes"]["position"]["array"].data
        return np.frombuffer(packed, "<f4").reshape(-1, 3).astype(float)

    def colour(self, path):
        return self.kept["set_object", path]["object"]["materials"][0]["color"]

    def picture(self, path):
        url = self.kept["set_object", path]["object"]["images"][0]["url"]
        return np.array(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))))

    def visible(self, path):
        return self.kept["set_property", path]["value"]


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def screen(recorder):
    return MonitorScreen(Visualizer(window=recorder))


def ball_at_the_tip(p_P):
    return 200 * np.exp(-np.sum((p_P - TIP) ** 2, axis=-1) / (2 * 0.003**2))


def estimate(volume, mode=TrackingMode.TRACKING, points=(ENTRY, TIP)):
    curve = NeedleCurve(points).transformed(volume.X_WP)
    n = len(points)
    return NeedleEstimate(mode, volume.time, curve, np.zeros((n, 3)), np.eye(6 * n), volume.time)


def brightest(recorder, path):
    """Where a picture is brightest: the mean of its corners, weighted as its texture is."""
    grey = recorder.picture(path)[..., 0].astype(float) ** 2
    rows, columns = grey.shape
    right = (grey.sum(axis=0) @ (np.arange(columns) + 0.5)) / grey.sum() / columns
    down = (grey.sum(axis=1) @ (np.arange(rows) + 0.5)) / grey.sum() / rows
    left_above, right_above, _, left_below = recorder.vertices(path)
    return left_above + right * (right_above - left_above) + down * (left_below - left_above)


@pytest.mark.parametrize("name", ["first", "second"])
def test_the_ring_is_around_the_echo_of_the_tip(screen, recorder, make_volume, name):
    volume = make_volume(ball_at_the_tip)
    screen.draw(volume, estimate(volume), 1)
    ring = recorder.vertices(f"screen/{name}/needle")[-128:]
    echo = brightest(recorder, f"screen/{name}/picture")
    scale = np.ptp(ring[:, 0]) / (2 * 2.85e-3)  # the ring is 2.5 mm in radius and 0.7 mm wide
    np.testing.assert_allclose(ring.mean(axis=0)[:2], echo[:2], atol=0.3e-3 * scale)
    # The same in the probe's frame.
    np.testing.assert_allclose(brightest(recorder, f"probe/{name}/picture"), TIP, atol=0.3e-3)
    ring = recorder.vertices(f"probe/{name}/needle")[-128:]
    np.testing.assert_allclose(ring.mean(axis=0), TIP, atol=1e-6)
    line = recorder.vertices(f"probe/{name}/needle")[:4]
    np.testing.assert_allclose(line.mean(axis=0), ENTRY + (TIP - ENTRY) / 80, atol=1e-6)


def test_the_pictures_have_the_same_scale(screen, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    screen.draw(volume, estimate(volume), 1)
    scales = []
    for name in ("first", "second"):
        flat, in_place = (recorder.vertices(f"{place}/{name}/picture") for place in PLACES)
        for a, b in ((0, 1), (0, 3)):
            scales.append(np.linalg.norm(flat[a] - flat[b]))
            scales[-1] /= np.linalg.norm(in_place[a] - in_place[b])
    np.testing.assert_allclose(scales, scales[0], rtol=1e-5)


def test_a_bent_needle_is_drawn_bent(screen, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    middle = 0.5 * (ENTRY + TIP) + [0.0, 0.004, 0.0]
    screen.draw(volume, estimate(volume, points=(ENTRY, middle, TIP)), 1)
    line = recorder.vertices("probe/first/needle")[:-128]
    chord = (TIP - ENTRY) / np.linalg.norm(TIP - ENTRY)
    off = np.linalg.norm(np.cross(line - ENTRY, chord), axis=1)
    sag = np.linalg.norm(np.cross(middle - ENTRY, chord))
    assert off.max() == pytest.approx(sag, abs=0.4e-3)


@pytest.mark.parametrize("mode", list(TrackingMode)[1:])
def test_the_colour_tells_the_mode(screen, recorder, make_volume, mode):
    volume = make_volume(ball_at_the_tip)
    screen.draw(volume, estimate(volume, mode), 1)
    red, green, blue = (round(255 * each) for each in MODE_COLOURS[mode])
    wanted = red << 16 | green << 8 | blue
    for path in ("screen/mode_colour", "screen/first/needle", "probe/second/needle"):
        assert recorder.colour(path) == wanted


def test_the_needle_goes_when_it_is_lost_from_view(screen, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    screen.draw(volume, estimate(volume), 1)
    assert recorder.visible("screen/first/needle")
    screen.draw(volume, NeedleEstimate(TrackingMode.SEARCHING, 0.0), 2)
    for name in ("first", "second"):
        for place in PLACES:
            assert recorder.visible(f"{place}/{name}")
            assert not recorder.visible(f"{place}/{name}/needle")
    screen.draw(volume, estimate(volume, points=(ENTRY + 1.0, TIP + 1.0)), 3)
    assert not recorder.visible("screen/second")  # its plane misses the volume


def test_what_did_not_change_is_not_sent_again(screen, recorder, make_volume):
    volume = make_volume(ball_at_the_tip)
    screen.draw(volume, estimate(volume), 1)
    recorder.paths.clear()
    screen.draw(volume, estimate(volume), 1)
    pictures = [f"{place}/{row}/{what}" for place in PLACES for row in ("first", "second")
                for what in ("picture", "needle")]  # fmt: skip
    assert sorted(recorder.paths) == sorted(pictures)
    recorder.paths.clear()
    screen.draw(make_volume(ball_at_the_tip, time=0.8), estimate(volume), 2)
    assert sorted(recorder.paths) == sorted([*pictures, "screen/volume", "screen/time"])


def test_a_volume_without_motion_has_the_outline_of_its_grid(screen, recorder, make_volume):
    volume = make_volume(ball_at_the_tip, motion=False)
    screen.draw(volume, None, 1)
    edges = recorder.vertices("probe/outline")
    np.testing.assert_allclose(edges.min(axis=0), volume.origin, atol=1e-7)
    np.testing.assert_allclose(edges.max(axis=0), volume.upper, atol=1e-7)
    assert len(edges) == 24


def test_readings(make_volume):
    volume = make_volume(ball_at_the_tip, time=12.346)
    said = readings(volume, estimate(volume), 42)
    assert said["volume"] == "volume 42"
    assert said["time"] == "12.35 s"
    assert said["mode"] == "tracking"
    assert said["tip"] == "tip depth 50.0 mm"
    assert said["features"] == "X +10.0 mm   Z +10.0 mm   Theta +36.9 deg"  # 3 across, 4 along
    lost = NeedleEstimate(TrackingMode.SEARCHING, 0.0, reason="nothing changed by more than 3.0 dB")
    said = readings(volume, lost, 43)
    assert (said["mode"], said["tip"]) == ("searching", "")
    assert said["reason"] == "nothing changed by more than 3.0 dB"
    assert said["advice"].startswith("push the needle into view")
    assert readings(volume, None, 1)["mode"] == "no tracker"


@pytest.mark.parametrize("upright", [False, True])
def test_a_scale_has_its_ticks_where_they_belong(upright):
    image = scale_image(-0.034, 0.052, 0.01, 0.4, upright=upright)[..., 1]
    image = image[:, ::-1].T if upright else image  # lying, the picture above it
    length = image.shape[1]
    ticks = np.flatnonzero(image[0] > 100)
    starts = ticks[np.diff(ticks, prepend=-9) > 1]
    pixels = 0.4 * PIXELS
    wanted = 0.5 * (length - pixels) + (np.arange(-3, 6) * 0.01 + 0.034) / 0.086 * pixels
    np.testing.assert_allclose(starts, wanted, atol=1.5)


def test_lines_of_a_size_are_as_high():
    assert {line_image(text, 40).shape[0] for text in ("mm", "Theta", "-", "g")} == {50}
    letters = line_image("l", 40)
    assert letters[..., 1].max() == 255
    assert letters[..., 0].min() == 255
