"""A shape prediction on its screens: in the world, and on the console."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display import ShapeView
from sonoservo.systems.display.console.readings import needle_readings
from sonoservo.systems.display.console.shape_page import ShapePage
from sonoservo.systems.display.world.parts import Rod
from sonoservo.systems.display.world.shape_world import ShapeWorld
from sonoservo.systems.signals import CrossSection, ImageSlice, Needle, NeedleShape, NotFound
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.ultrasound import ImagingParameters, load_transducer, sweep_geometry

X_WP = RigidTransform([0.1, 0.0, 0.0])
SLICE = ImageSlice(np.full((30, 40), 90, np.uint8), [-0.003, 0.0], [2e-4, 2e-4], X_WP, 0.5)
FOUND = CrossSection(
    [0.101, 0.003, 0.0], X_WP.GetAsMatrix4(), 0.5, 0.9, [1e-3, 3e-3], np.ones((3, 3))
)
SHAPE = NeedleShape(
    parameters=[[1.0, 0.0, 0.0]], origins=[[1e-3, 3e-3]], weights=[1.0], origin_variance=1e-6,
    rotations=(), depth=0.1, observed=0.0, X_WI=X_WP, time=0.5,
)  # fmt: skip
NEEDLE = Needle([[0.101, 0.003, -0.01], [0.1012, 0.003, 0.0]], 6e-4)
OUTSIDE = Needle(np.zeros((0, 3)), 6e-4)


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


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def console():
    return Console()


@pytest.fixture
def tubes(monkeypatch):
    """What rods with radii of their own are told to show."""
    told = []
    show = Rod.show

    def noting(rod, polyline, time, radii=None):
        if radii is not None:
            told.append((np.array(polyline), radii))
        show(rod, polyline, time, radii)

    monkeypatch.setattr(Rod, "show", noting)
    return told


@pytest.fixture
def view(meshcat, console):
    settings = ImagingParameters(transmit_frequency=7.5e6, frames=1)
    geometry = sweep_geometry(load_transducer("4dl14_5_38"), settings)
    world = ShapeWorld(meshcat=meshcat, tissue_size=[0.2, 0.1, 0.1], depth=0.1, geometry=geometry)
    return ShapeView(screens=[world, ShapePage(console=console, depth=0.1)], period=1.0)


def publish(view, **values):
    context = view.CreateDefaultContext()
    view.GetInputPort("X_WT").FixValue(context, Value(RigidTransform()))
    for name, value in values.items():
        view.GetInputPort(name).FixValue(context, Value[object](value))
    view.ForcedPublish(context)


def test_slice_cross_section_paths_and_figures_are_shown(view, meshcat, console, tubes):
    publish(view, slice=SLICE, cross_section=FOUND, shape=SHAPE, needle=NEEDLE)
    ((polyline, radii),) = tubes
    assert np.allclose(radii, 1e-3 * RADIUS_95 + 1.5e-3)  # 95 %, around the drawn path
    assert np.allclose(polyline[-1], SHAPE.tip)
    assert np.allclose(polyline[0], X_WP.multiply([1e-3, 3e-3, 0]))
    assert all(meshcat.HasPath(path) for path in ("/probe", "/predicted", "/slice/live"))
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


def test_a_slice_is_shown_once_and_one_without_a_needle_says_why(view, console, tubes):
    missing = NotFound("no bright spot")
    for slice_ in (missing, SLICE, SLICE):
        publish(view, slice=slice_, cross_section=missing, shape=missing, needle=OUTSIDE)
    assert tubes == []
    assert len(console.frames) == len(console.samples) == 1
    assert console.samples[0].reason == "no bright spot"
    assert console.frames[0].paths["depth"] == []
    assert not len(console.frames[0].pictures[0].tip)


def test_the_true_needle_is_that_at_each_slice_whatever_the_tissue_does_later(view, console):
    later = replace(SLICE, X_WP=X_WP @ RigidTransform([0, 0, 0.01]), time=SLICE.time + 1)
    moved = Needle([[0.103, 0.003, -0.01], [0.107, 0.003, 0.02]], 6e-4)
    for slice_, needle in ((SLICE, NEEDLE), (later, moved)):
        publish(view, slice=slice_, cross_section=FOUND, shape=SHAPE, needle=needle)
    first, second = (each.paths for each in console.frames)
    assert second["true_depth"] == pytest.approx([0.0, 10.0])
    assert second["true_x"][:1] == first["true_x"]
