import base64
import re
from dataclasses import replace

import numpy as np
import pytest
from packed_scene import boxes, scales, transform, visible
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from sonoservo.systems.display import WorldView
from sonoservo.systems.display.textured_quads import encode_png, gltf_textured_quads
from sonoservo.systems.display.world.parts import Film
from sonoservo.systems.evaluation.reports.report import save_replay
from sonoservo.systems.signals import (
    GuardState,
    GuardStatus,
    Needle,
    NeedleCurve,
    NeedleEstimate,
    NotFound,
    Plane,
    TrackingMode,
    slice_planes,
)

X_WT = RigidTransform(RollPitchYaw(0, 0, 0.4), [0.4, 0.1, 0.25])
NEEDLE = Needle([[0.0, 0.0, -0.04], [0.06, 0.0, -0.04]], 6e-4)
OUTSIDE = Needle(np.zeros((0, 3)), 6e-4)


def grey(p_P):
    return 100 + 500 * p_P[..., 0]


def estimate(volume, mode=TrackingMode.TRACKING):
    curve = NeedleCurve([[-0.03, 0.04, 0], [0.01, 0.05, 0.01]]).transformed(volume.X_WP)
    return NeedleEstimate(mode, volume.time, curve, np.zeros((2, 3)), np.eye(12), volume.time)


def searching(time=0.0, volume_time=-np.inf):
    return NeedleEstimate(TrackingMode.SEARCHING, time, volume_time=volume_time)


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


def publish(view, time, X_WP, **values):
    context = view.CreateDefaultContext()
    context.SetTime(time)
    view.GetInputPort("X_WP").FixValue(context, Value(X_WP))
    view.GetInputPort("X_WT").FixValue(context, Value(X_WT))
    for name, value in values.items():
        port = view.GetInputPort(name)
        port.FixValue(context, [value] if name == "contact_force" else Value[object](value))
    view.ForcedPublish(context)


def scale(meshcat, path):
    return scales(meshcat, path)[2]


def test_the_needle_is_where_it_is(meshcat):
    """A bent one in pieces, a straight one whole, and what is outside is known or guessed."""
    view = WorldView(meshcat=meshcat, path="truth")
    publish(view, 0.0, RigidTransform(), needle=OUTSIDE)
    assert not visible(meshcat, "truth/needle/inside")
    assert not visible(meshcat, "truth/needle/tip")
    corner = [[0, 0, -0.04], [0.03, 0, -0.04], [0.03, 0.03, -0.04]]
    shaft = np.concatenate([np.linspace(*corner[:2], 20), np.linspace(*corner[1:], 20)])
    publish(view, 1.0, RigidTransform(), needle=Needle(shaft, 6e-4))
    for number in range(6):
        along = 0.01 * (number + 0.5)
        middle = [along, 0, -0.04] if along < 0.03 else [0.03, along - 0.03, -0.04]
        X = transform(meshcat, f"truth/needle/inside/{number}")
        np.testing.assert_allclose(X[:3, 3], X_WT.multiply(middle), atol=1e-9)
        assert scale(meshcat, f"truth/needle/inside/{number}/unit") == pytest.approx(0.01)
    publish(view, 2.0, RigidTransform(), needle=NEEDLE)
    assert visible(meshcat, "truth/needle/inside")
    assert visible(meshcat, "truth/needle/tip")
    lengths = [scale(meshcat, f"truth/needle/inside/{number}/unit") for number in range(6)]
    np.testing.assert_allclose(lengths, [0.06, 0, 0, 0, 0, 0], atol=1e-5)
    X = transform(meshcat, "truth/needle/inside/0")
    np.testing.assert_allclose(X[:3, 2], X_WT.rotation().matrix()[:, 0], atol=1e-12)
    for path, x in {"inside/0": 0.03, "tip": 0.06, "outside/0": -0.045}.items():
        X = transform(meshcat, f"truth/needle/{path}")
        np.testing.assert_allclose(X[:3, 3], X_WT.multiply([x, 0, -0.04]), atol=1e-12)
    waiting = Needle(np.zeros((0, 3)), 6e-4, [[-0.01, 0, -0.04], [0.5, 0, -0.04]])
    publish(view, 3.0, RigidTransform(), needle=waiting)
    assert not visible(meshcat, "truth/needle/inside")
    outside = transform(meshcat, "truth/needle/outside/0")
    np.testing.assert_allclose(outside[:3, 3], X_WT.multiply([-0.085, 0, -0.04]), atol=1e-12)
    assert scale(meshcat, "truth/needle/outside/0/unit") == pytest.approx(0.15)
    publish(view, 4.0, RigidTransform(), needle=OUTSIDE)
    assert not visible(meshcat, "truth/needle/outside")


def test_the_estimate_shows_its_mode(meshcat, make_volume):
    volume = make_volume(grey)
    view = WorldView(meshcat=meshcat, path="modes")
    for time, mode in enumerate(TrackingMode):
        found = mode != TrackingMode.SEARCHING
        shown = estimate(volume, mode) if found else searching(volume_time=0.0)
        publish(view, time, volume.X_WP, estimate=shown)
        for other in list(TrackingMode)[: time + 1]:
            assert visible(meshcat, f"modes/phase/{other}") == (other == mode)
        for other in TrackingMode:
            if other != TrackingMode.SEARCHING:
                assert visible(meshcat, f"modes/estimate/{other}") == (other == mode)
        assert visible(meshcat, "modes/uncertainty/tip") == found
        if found:
            end = transform(meshcat, f"modes/estimate/{mode}/3")
            length = scale(meshcat, f"modes/estimate/{mode}/3/unit")
            tip = estimate(volume).curve.tip
            np.testing.assert_allclose(end @ [0, 0, 0.5 * length, 1], [*tip, 1])
            ring = transform(meshcat, f"modes/estimate/{mode}/ring")
            np.testing.assert_allclose(ring[:3, 3], tip)
            np.testing.assert_allclose(ring[:3, 2], estimate(volume).curve.direction, atol=1e-12)


def test_a_stop_shows_its_reason_in_place_of_the_mode(meshcat, make_volume):
    volume = make_volume(grey)
    view = WorldView(meshcat=meshcat, path="stops")
    watching = GuardStatus(GuardState.MONITORING)
    holding = GuardStatus(GuardState.HOLDING, "the sensor is frozen", 1.0, 1)
    for time, guard in enumerate((watching, holding, watching)):
        publish(view, time, volume.X_WP, estimate=estimate(volume), guard=guard)
        assert visible(meshcat, "stops/phase/tracking") == (guard is watching)
        assert not visible(meshcat, "stops/phase")  # the console says it beside the view
        if time:
            path = "stops/phase/stopped: the sensor is frozen"
            assert visible(meshcat, path) == (guard is holding)


def test_the_ellipsoid_at_the_tip_is_the_tip_s_covariance(meshcat, make_volume):
    volume = make_volume(grey)
    view = WorldView(meshcat=meshcat, path="uncertain")
    # Of the four points only the second position is the tip's; R turns its axes out of W's.
    R = RollPitchYaw(0.3, -0.4, 0.9).ToRotationMatrix().matrix()
    covariance = np.eye(12)
    covariance[3:6, 3:6] = R @ np.diag([1e-6, 4e-6, 9e-6]) @ R.T
    believed = replace(estimate(volume), covariance=covariance)
    publish(view, 0.0, volume.X_WP, estimate=believed)
    X = transform(meshcat, "uncertain/uncertainty/tip")
    np.testing.assert_allclose(X[:3, 3], believed.curve.tip)
    half_axes = scales(meshcat, "uncertain/uncertainty/tip/unit")
    # 95 % of chi-square with three degrees of freedom, from a table: 7.815.
    np.testing.assert_allclose(half_axes, np.sqrt(7.815) * np.array([1e-3, 2e-3, 3e-3]), rtol=1e-4)
    np.testing.assert_allclose(np.abs(X[:3, :3].T @ R), np.eye(3), atol=1e-9)


def test_slices_wait_for_the_tracker(meshcat, make_volume):
    volume = make_volume(grey, time=0.5)
    view = WorldView(meshcat=meshcat, path="waiting", film_frames=9)
    publish(view, 0.7, volume.X_WP, volume=volume, estimate=searching())
    assert not meshcat.HasPath("/drake/waiting/slices/live")
    assert visible(meshcat, "waiting/phase/waiting for the first volume")
    publish(view, 0.8, volume.X_WP, volume=volume, estimate=estimate(volume))
    planes = slice_planes(volume, estimate(volume).curve)
    for path in ("waiting/slices/live", "waiting/slices/0"):
        for box, plane in zip(boxes(meshcat, path), planes, strict=True):
            corners = volume.X_WP.multiply(
                plane.grid(1000, 1000)[[[0], [-1]], [0, -1]].reshape(4, 3).T
            )
            expected = [corners.min(axis=1), corners.max(axis=1)]
            np.testing.assert_allclose(box, expected, atol=1e-4)  # half a pixel
        assert not meshcat._GetPackedTransform(path)  # it would come before the pictures
    publish(view, 0.9, volume.X_WP, volume=volume, estimate=estimate(volume))
    assert not meshcat.HasPath("/drake/waiting/slices/1")  # the same volume is not drawn twice
    assert not visible(meshcat, "waiting/phase/waiting for the first volume")


def test_the_force_is_an_arrow_onto_the_phantom_with_its_value(meshcat):
    view = WorldView(meshcat=meshcat, path="push")
    X_WP = RigidTransform([0.5, 0.1, 0.2])
    publish(view, 0.0, X_WP, contact_force=0.0)
    assert not visible(meshcat, "push/force/arrow")
    normal = X_WT.rotation().matrix()[:, 2]
    for time, force in ((1.0, 1.0), (2.0, 2.04)):
        publish(view, time, X_WP, contact_force=force)
        assert visible(meshcat, "push/force/arrow")
        assert scale(meshcat, "push/force/arrow/0/unit") == pytest.approx(0.02 * force)
        head = transform(meshcat, "push/force/arrow/head")
        np.testing.assert_allclose(head[:3, 2], normal, atol=1e-12)  # its apex points down
        assert np.linalg.norm(head[:3, 3] - X_WP.translation()) == pytest.approx(0.045)
    assert not visible(meshcat, "push/force/value/1.0 N")
    assert visible(meshcat, "push/force/value/2.0 N")
    publish(view, 3.0, X_WP, contact_force=-1.0)
    assert not visible(meshcat, "push/force/arrow")
    assert not visible(meshcat, "push/force/value/2.0 N")


class Volumes(LeafSystem):
    """A new volume every 0.25 s."""

    def __init__(self, make_volume):
        super().__init__()
        self._make = make_volume
        index = self.DeclareAbstractState(Value[object](NotFound("none")))
        self.DeclareStateOutputPort("volume", index)
        for name in ("X_WP", "X_WT"):
            pose = Value(RigidTransform()).Clone
            self.DeclareAbstractOutputPort(name, pose, lambda context, output: None)
        self.DeclareAbstractOutputPort("needle", Value[object](OUTSIDE).Clone, self._needle)
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.25, 0.25, self._update)

    def _needle(self, context, output):
        output.set_value(NEEDLE if context.get_time() > 1 else OUTSIDE)

    def _update(self, context, state):
        state.get_mutable_abstract_state(0).set_value(self._make(grey, time=context.get_time()))


def simulate(meshcat, make_volume, film_frames):
    builder = DiagramBuilder()
    source = builder.AddSystem(Volumes(make_volume))
    view = builder.AddSystem(WorldView(meshcat=meshcat, path="all", film_frames=film_frames))
    for name in ("volume", "X_WP", "X_WT", "needle"):
        builder.Connect(source.GetOutputPort(name), view.GetInputPort(name))
    return Simulator(builder.Build())


def shown(animation, path):
    """Values, in order of time, of the track `visible` of a path in a packed animation."""
    clips = animation.split(b"\xa4path")
    (clip,) = (clip for clip in clips if path.encode() + b"\xa4clip" in clip)
    assert clip.count(b".visible") == clip.count(b"\xa4type") == 1
    return [value == b"\xc3" for value in re.findall(b"value([\xc2\xc3])", clip)]


def test_pictures_are_held_for_pages_that_are_slow(meshcat):
    film = Film(meshcat=meshcat, path="film", frames=0, period=1.0)
    picture = gltf_textured_quads(
        [Plane(RigidTransform(), 0.1, 0.1)], [encode_png(np.zeros((2, 2), np.uint8))]
    )
    for step in range(150):
        film.show(picture, 0.1 * step)
    held = [meshcat.HasPath(f"film/recent/{number}") for number in (0, 48, 52)]
    assert held == [True, True, False]  # 5 s of them, however many a second there are


@pytest.mark.parametrize(("frames", "kept"), [(100, 5), (3, 3), (0, 0)])
def test_a_replay_keeps_its_film(tmp_path, make_volume, frames, kept):
    meshcat = Meshcat()
    meshcat.StartRecording()
    simulator = simulate(meshcat, make_volume, frames)
    simulator.AdvanceTo(1.9)
    names = [meshcat.HasPath(f"/drake/all/slices/{number}") for number in range(8)]
    assert names == [number < kept for number in range(8)]
    assert meshcat.HasPath("/drake/all/slices/live") == (kept > 0)  # nobody looks
    text = save_replay(meshcat, tmp_path / "replay.html").read_text()
    messages = [base64.b64decode(each) for each in re.findall(r"base64,([A-Za-z0-9+/=]+)", text)]
    (animation,) = (each for each in messages if b"set_animation" in each)
    assert animation.count(b"all/slices/") == kept + (kept > 0)  # the live one is hidden
    for path in ["needle/inside", *(f"slices/{number}" for number in range(kept))]:
        assert shown(animation, f"all/{path}")[:2] == [False, True]
    assert shown(animation, "all/phase") == [True]
    if kept:
        assert shown(animation, "all/slices/live") == [False]
        assert shown(animation, f"all/slices/{kept - 1}") == [False, True]  # to the end
    pictures = [each for each in messages if b"set_object" in each and b"/slices/" in each]
    pictures = [each for each in pictures if b"/recent/" not in each]
    assert len(pictures) == kept + (kept > 0)
    simulator.reset_context(simulator.get_system().CreateDefaultContext())
    simulator.Initialize()
    assert not meshcat.HasPath("/drake/all/slices")  # each run begins anew
