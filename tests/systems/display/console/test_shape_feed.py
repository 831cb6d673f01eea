import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.systems.display.console.readings import needle_readings
from sonoservo.systems.display.console.shape_feed import ShapeFeed
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_shape import NeedleShape

X_WP = RigidTransform([0.1, 0.0, 0.0])
SLICE = ImageSlice(np.full((30, 40), 90, np.uint8), [-0.003, 0.0], [2e-4, 2e-4], X_WP, 0.5)
FOUND = CrossSection(
    [0.101, 0.003, 0.0], X_WP.GetAsMatrix4(), 0.5, 0.9, [1e-3, 3e-3], np.ones((3, 3))
)
SHAPE = NeedleShape(
    parameters=[[1.0, 0.0, 0.0]], origins=[[1e-3, 3e-3]], weights=[1.0], origin_variance=1e-6,
    rotations=(), depth=0.1, observed=0.0, X_WI=X_WP, time=0.5,
)  # fmt: skip


class Console:
    """Keeps what it is told."""

    def __init__(self):
        self.frames, self.samples, self.facts = [], [], {}

    def say(self, **facts):
        self.facts |= facts

    def show_frame(self, frame):
        self.frames.append(frame)

    def add(self, sample):
        self.samples.append(sample)


def publish(feed, **values):
    context = feed.CreateDefaultContext()
    feed.GetInputPort("X_WT").FixValue(context, Value(RigidTransform()))
    for name, value in values.items():
        feed.GetInputPort(name).FixValue(context, Value[object](value))
    feed.ForcedPublish(context)


def test_slice_cross_section_paths_and_figures_are_shown():
    console = Console()
    feed = ShapeFeed(console=console, depth=0.1, period=1.0)
    needle = Needle([[0.101, 0.003, -0.01], [0.1012, 0.003, 0.0]], 6e-4)
    publish(feed, slice=SLICE, cross_section=FOUND, shape=SHAPE, needle=needle)
    (frame,), (sample,) = console.frames, console.samples
    (picture,) = frame.pictures
    np.testing.assert_allclose(picture.tip, [1.0, 3.0])
    assert picture.grey.shape == (40, 30)  # the depth runs down
    assert (frame.paths["found_x"], frame.paths["found_depth"]) == ([0.0], [0.0])
    # A path of radius 1 m bends by 5 mm over 100 mm, in the plane of X; the tube has 1 mm.
    assert frame.paths["x"][-1] == pytest.approx(5.0, abs=0.05)
    assert frame.paths["y"][-1] == pytest.approx(0.0, abs=1e-6)
    assert frame.paths["x_high"][-1] - frame.paths["x"][-1] == pytest.approx(1.96)
    shown = {each.name: each.value for each in needle_readings(sample)}
    assert shown["error"] == pytest.approx(0.2)
    assert shown["final"] == pytest.approx(5.0, abs=0.05)
    assert {"second", "mode", "planes"} <= set(console.facts["without"])


def test_a_slice_is_shown_once_and_one_without_a_needle_says_why():
    console = Console()
    feed = ShapeFeed(console=console, depth=0.1, period=1.0)
    missing = NotFound("no bright spot")
    outside = Needle(np.zeros((0, 3)), 6e-4)
    for slice_ in (missing, SLICE, SLICE):
        publish(feed, slice=slice_, cross_section=missing, shape=missing, needle=outside)
    assert len(console.frames) == len(console.samples) == 1
    assert console.samples[0].reason == "no bright spot"
    assert console.frames[0].paths["depth"] == []
    assert not len(console.frames[0].pictures[0].tip)
