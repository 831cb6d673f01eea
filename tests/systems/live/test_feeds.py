from importlib.resources import files
from xml.etree import ElementTree

import numpy as np
import pytest
from live_items import FakeOutlet, X, make_estimate, make_volume
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource

from sonoservo.systems.live import NeedleNames, Sender, VolumeReceiver
from sonoservo.systems.live.acquisition import read_acquisition_item
from sonoservo.systems.live.connection.address import DEFAULT_PORT
from sonoservo.systems.live.connection.items import PointsItem
from sonoservo.systems.live.feeds import (
    IMAGE,
    NEEDLE,
    SLICES,
    TIP,
    needle_feed,
    needle_items,
    pose_feed,
    slice_feed,
    sweep_feed,
    truth_feed,
    truth_items,
    volume_feed,
)
from sonoservo.systems.live.image_matcher import DEFAULT_POSES
from sonoservo.systems.signals import (
    Needle,
    NeedleEstimate,
    NotFound,
    Sweep,
    SweepGeometry,
    SweepMotion,
    TrackingMode,
    Volume,
)


@pytest.fixture
def outlet():
    return FakeOutlet()


def publish(system, **inputs):
    """Force the leaf's event with values on its ports, as often as there are values."""
    context = system.CreateDefaultContext()
    for values in zip(*inputs.values(), strict=True):
        for name, value in zip(inputs, values, strict=True):
            kind = Value if isinstance(value, RigidTransform) else Value[object]
            system.GetInputPort(name).FixValue(context, kind(value))
        system.ForcedPublish(context)


def sweep(direction=1):
    geometry = SweepGeometry(0.04, 0.03, 0.02, 0.05, 1e-3, 6, 4, 20, 0.05)
    samples = np.random.default_rng(0).integers(0, 255, geometry.shape, dtype=np.uint8)
    times = 1.0 + 0.05 * np.arange(4)[::direction]
    poses = np.array([RigidTransform([0.001 * k, 0, 0]).GetAsMatrix4() for k in range(4)])
    return Sweep(samples, SweepMotion(geometry, direction, times, poses))


def test_estimate_is_told_by_its_parts():
    status, tip, curve, covariance = needle_items(make_estimate(3), NeedleNames(), 5.0)
    assert {item.time for item in (status, tip, curve, covariance)} == {5.0}
    assert (tip.name, curve.name) == ("NeedleTipToReference", "Needle")
    assert (status.good, status.text) == (True, "tracking")
    assert len(curve.points) == 21
    needle = make_estimate(3).curve
    np.testing.assert_array_equal(tip.X.translation(), needle.tip)
    np.testing.assert_allclose(tip.X.rotation().col(2), needle.tangent(1.0), atol=1e-12)
    np.testing.assert_array_equal(covariance.covariance, make_estimate(3).tip_covariance)
    estimate = NeedleEstimate(TrackingMode.SEARCHING, 1.0, reason="no insertion yet")
    (status,) = needle_items(estimate, NeedleNames(), 5.0)
    assert (status.good, status.text) == (False, "searching: no insertion yet")


def test_names_can_be_set_and_left_out():
    names = NeedleNames(tip="Tip", curve="", points=True)
    items = needle_items(make_estimate(), names, 5.0)
    assert [item.name for item in items] == ["NeedleStatus", "Tip", "NeedleTipCovariance"]
    (_, _, points, _) = needle_items(make_estimate(), NeedleNames(points=True), 5.0)
    assert isinstance(points, PointsItem)
    assert len(points.points) == 2


def test_needle_sender_sends_each_estimate_once_with_its_volumes_time(outlet):
    sender = Sender(outlet=outlet, feed=needle_feed(), period=1.0)
    estimates = [make_estimate(volume_time=t) for t in (1.0, 1.0, 2.0)]
    publish(sender, estimate=estimates)
    assert [items[0].time for _, items in outlet.sent] == [1.0, 2.0]
    assert {topic for topic, _ in outlet.sent} == {"estimate"}


def test_volume_sender_sends_each_volume_once(outlet):
    sender = Sender(outlet=outlet, feed=volume_feed(settings={"tracker_seed": 7}), period=1.0)
    volumes = [NotFound("none yet"), make_volume(1.0), make_volume(1.0), make_volume(2.0)]
    publish(sender, volume=volumes)
    assert len(outlet.sent) == 2
    text, pose, image = outlet.sent[0][1]
    said = read_acquisition_item(text)
    assert said.settings == {"tracker_seed": 7}
    np.testing.assert_array_equal(said.origin, volumes[1].origin)
    assert pose.name == "ProbeToReference"
    assert pose.X.IsExactlyEqualTo(X)
    index = np.array([1, 2, 3, 1])
    np.testing.assert_allclose((image.X_LI @ index)[:3], volumes[1].position(index[:3]))
    publish(Sender(outlet=outlet, feed=volume_feed(posed=False), period=1.0), volume=volumes[1:2])
    assert [item.name for item in outlet.sent[-1][1]] == ["Acquisition", "Image_Probe"]


def test_acquisition_of_a_very_long_sweep_leaves_the_frames_out(outlet):
    geometry = SweepGeometry(0, 0, 0.02, 0.001, 1e-3, 6, 400, 20, 0.05)
    turns = RollPitchYaw(0.1, 0.2, 0.3)
    poses = np.array([RigidTransform(turns, [k / 7, 0, 0]).GetAsMatrix4() for k in range(400)])
    motion = SweepMotion(geometry, 1, np.arange(400.0) / 3, poses)
    volume = Volume(np.zeros((3, 3, 3), np.uint8), [0, 0, 0], [1e-3] * 3, X, 1.0, motion)
    publish(Sender(outlet=outlet, feed=volume_feed(), period=1.0), volume=[volume])
    text = outlet.sent[0][1][0]
    assert len(text.text) < 65536
    assert read_acquisition_item(text).motions == [None]


@pytest.mark.parametrize("direction", [1, -1])
def test_sweep_sender_sends_the_frames_in_order_of_time(outlet, direction):
    sent = sweep(direction)
    publish(
        Sender(outlet=outlet, feed=sweep_feed(), period=1.0), sweep=[NotFound("none"), sent, sent]
    )
    ((_, items),) = outlet.sent
    frames = items[1::2]
    np.testing.assert_allclose([item.time for item in frames], 1.0 + 0.05 * np.arange(4))
    np.testing.assert_array_equal(frames[0].voxels[..., 0], sent.samples[::direction][0].T)
    assert items[0].X.translation()[0] == pytest.approx(0.0 if direction > 0 else 0.003)


def test_slices_are_where_the_volume_is(outlet):
    volume = make_volume(shape=(20, 24, 18))
    publish(
        Sender(outlet=outlet, feed=slice_feed(), period=1.0),
        volume=[volume],
        estimate=[make_estimate()],
    )
    for item in outlet.sent[0][1]:
        assert item.name in ("SliceA_Probe", "SliceB_Probe")
        ni, nj, _ = item.voxels.shape
        p_P = (item.X_LI @ [ni // 2, nj // 2, 0, 1])[:3]
        i, j, k = np.clip(np.round(volume.index(p_P)).astype(int), 0, np.array([19, 23, 17]))
        near = volume.intensities[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2]
        assert near.min() <= item.voxels[ni // 2, nj // 2, 0] <= near.max()


def test_transform_sender_sends_a_pose_at_its_rate(outlet):
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantValueSource(Value(X)))
    sender = builder.AddSystem(Sender(outlet=outlet, feed=pose_feed("Arm"), period=0.25))
    builder.Connect(source.get_output_port(), sender.GetInputPort("X_WP"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.9)
    assert [items[0].time for _, items in outlet.sent] == [0.0, 0.25, 0.5, 0.75]
    assert outlet.sent[0][1][0].X.IsExactlyEqualTo(X)


def test_truth_has_names_that_say_so(outlet):
    needle = Needle([[0, 0, 0], [0, 0, -0.03], [0.001, 0, -0.05]], 5e-4)
    publish(Sender(outlet=outlet, feed=truth_feed(), period=1.0), needle=[needle], X_WT=[X])
    items = outlet.sent[0][1]
    assert [item.name for item in items] == ["TrueTissueToRef", "TrueNeedle", "TrueTipToReference"]
    np.testing.assert_allclose(items[2].X.translation(), X.multiply(needle.tip))
    along = X.rotation().multiply(needle.tip - needle.shaft[1])
    assert items[2].X.rotation().col(2) @ along > 0.999 * np.linalg.norm(along)
    assert [item.name for item in truth_items(Needle(np.empty((0, 3)), 5e-4), X, 0.0)] == [
        "TrueTissueToRef"
    ]


class Volumes:
    """A source with volumes that come when they are put in."""

    def __init__(self):
        self.waiting = []

    def take(self, timeout=0.0):
        return self.waiting.pop(0) if self.waiting else NotFound("no volume has come from X")


def test_receiver_takes_a_message_in_at_the_next_step():
    source, clock = Volumes(), [0.0]
    receiver = VolumeReceiver(source=source, stale_after=2.0, clock=lambda: clock[0])
    simulator = Simulator(receiver)
    port = receiver.GetOutputPort("volume")

    def now():
        return port.Eval(simulator.get_context())

    simulator.Initialize()
    assert now().reason == "no volume has come yet"
    source.waiting.append(make_volume(5.0))
    assert not now()
    simulator.AdvanceTo(0.1)
    assert now().time == 5.0
    clock[0] = 1.9
    simulator.AdvanceTo(0.2)
    assert now().time == 5.0
    clock[0] = 2.1
    simulator.AdvanceTo(0.3)
    assert now().reason == "no volume has come from X for 2 s"
    source.waiting.append(make_volume(6.0))
    receiver.ExecuteForcedEvents(simulator.get_mutable_context())
    assert now().time == 6.0


def test_scene_connects_and_places_the_images_under_the_probe():
    text = (files("sonoservo.systems.live") / "slicer.mrml").read_text()
    nodes = {node.get("name"): node for node in ElementTree.fromstring(text)}
    connector = nodes["sonoservo"]
    assert connector.tag == "IGTLConnector"
    assert int(connector.get("serverPort")) == DEFAULT_PORT
    names = NeedleNames()
    expected = {IMAGE, *SLICES, DEFAULT_POSES, names.tip, names.curve, NEEDLE, TIP}
    assert expected == nodes.keys() - {"sonoservo", None}
    for name in (IMAGE, *SLICES):
        assert nodes[name].get("references") == f"transform:{nodes[DEFAULT_POSES].get('id')};"
