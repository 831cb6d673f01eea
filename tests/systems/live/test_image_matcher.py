import numpy as np
import pytest
from live_items import make_volume
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.live.connection.items import ImageItem, PoseItem, TextItem
from sonoservo.systems.live.feeds import volume_items
from sonoservo.systems.live.image_matcher import ImageMatcher, LeftOut


def image(time, name="Image", shape=(4, 3, 2)):
    return ImageItem(name, time, np.zeros(shape, np.uint8), np.eye(4))


def pose(time, x=0.0, name="ProbeToReference"):
    return PoseItem(name, time, RigidTransform([x, 0, 0]))


ACQUISITION = volume_items(make_volume(1.0))[0].text


@pytest.fixture
def lines():
    return []


@pytest.fixture
def matcher(lines):
    return ImageMatcher(poses="ProbeToReference", report=lines.append)


def test_image_waits_for_the_pose_after_it_and_has_the_one_between(matcher):
    assert matcher.feed(pose(1.0, 0.0), 0.0) == []
    assert matcher.feed(image(1.1), 0.1) == []
    (posed,) = matcher.feed(pose(1.2, 0.2), 0.12)
    np.testing.assert_allclose(posed.X_WL.translation(), [0.1, 0, 0], atol=1e-12)
    assert (posed.time, posed.arrived) == (1.1, 0.1)
    assert matcher.posed


def test_poses_are_sorted_and_bridged_along_the_shortest_turn(matcher):
    """One comes twice, after one that is later."""
    for time, x, turn in ((1.0, 0.0, 3.0), (1.3, 7.0, 0.0), (1.2, 5.0, 1.0), (1.2, 0.1, -3.0)):
        X_WL = RigidTransform(RotationMatrix.MakeZRotation(turn), [x, 0, 0])
        matcher.feed(PoseItem("ProbeToReference", time, X_WL), 0.0)
    (posed,) = matcher.feed(image(1.1), 0.0)
    halfway = RigidTransform(RotationMatrix.MakeZRotation(np.pi), [0.05, 0, 0])
    assert posed.X_WL.IsNearlyEqualTo(halfway, 1e-9)


def test_poses_whose_clock_is_set_back_begin_anew(matcher):
    matcher.feed(pose(1000.0), 0.0)
    matcher.feed(pose(1.0), 0.1)
    assert matcher.feed(image(1.02), 0.12) == []
    (posed,) = matcher.feed(pose(1.04, 0.2), 0.14)
    np.testing.assert_allclose(posed.X_WL.translation(), [0.1, 0, 0], atol=1e-9)


def test_image_does_not_wait_for_ever_and_poses_far_apart_are_not_bridged(matcher, lines):
    matcher.feed(pose(1.0), 0.0)
    assert matcher.feed(image(1.03), 0.03) == []
    assert len(matcher.release(0.2)) == 1
    matcher.feed(image(2.0), 1.0)
    assert matcher.release(1.2) == []
    assert matcher.left_out == {LeftOut.NO_POSE: 1}
    assert "the nearest pose is 1.000 s away" in lines[-1]
    matcher.feed(pose(4.0), 3.0)
    assert matcher.feed(image(2.5), 3.0) == []
    assert matcher.left_out == {LeftOut.NO_POSE: 2}


def test_without_poses_the_probe_is_at_rest_until_they_come(lines):
    matcher = ImageMatcher(report=lines.append)
    assert matcher.feed(image(1.0), 0.0) == []
    assert len(matcher.release(0.6)) == 1
    assert "'ProbeToReference'" in lines[-1]
    (posed,) = matcher.feed(image(1.3), 0.7)
    assert posed.X_WL.IsExactlyEqualTo(RigidTransform())
    assert not matcher.posed
    matcher.feed(pose(2.0, 9.0), 1.0)  # its marker was hidden till now
    (posed,) = matcher.feed(image(2.0), 1.0)
    np.testing.assert_array_equal(posed.X_WL.translation(), [9, 0, 0])
    assert matcher.posed
    assert "poses have come" in lines[-1]
    matcher = ImageMatcher(report=lines.append)  # what tells how an image was acquired has its pose
    matcher.feed(TextItem("Acquisition", 1.0, ACQUISITION), 0.0)
    assert len(matcher.feed(image(1.0), 0.0)) == 1
    assert matcher.posed


def test_first_device_is_kept_and_a_named_one_preferred():
    matcher = ImageMatcher(poses="none")
    assert [p.image.name for k in range(3) for p in matcher.feed(image(k, "AB"[k % 2]), k)] == [
        "A",
        "A",
    ]
    matcher = ImageMatcher(device="B", poses="none")
    assert [p.image.name for k in range(3) for p in matcher.feed(image(k, "AB"[k % 2]), k)] == ["B"]


def test_frames_are_no_volumes_and_volumes_no_frames(lines):
    matcher = ImageMatcher(device="F", poses="none", report=lines.append)
    assert matcher.feed(image(1.0, "F", (4, 3, 1)), 0.0) == []
    assert "4 x 3 x 1 numbers are no volume; --reconstruct" in lines[-1]
    frames = ImageMatcher(poses="none", layers=False)
    assert frames.feed(image(1.0), 0.0) == []
    assert len(frames.feed(image(1.0, "F", (4, 3, 1)), 0.0)) == 1


def test_stamps_that_stand_still_or_run_back_a_little_are_left_out(lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    times = [p.time for t in (1.0, 1.3, 1.3, 1.2, 1.6) for p in matcher.feed(image(t), t)]
    assert times == [1.0, 1.3, 1.6]
    assert matcher.left_out == {LeftOut.STAMP: 2}
    assert "is not later than the last one's" in lines[-1]


@pytest.mark.parametrize("stamps", ["zero", "whole seconds", "ms"])
def test_stamps_that_do_not_run_give_way_to_the_times_of_arrival(stamps, lines):
    matcher, out = ImageMatcher(poses="ProbeToReference", report=lines.append), []
    for k in range(12):
        now = 50.0 + 0.1 * k
        stamp = {"zero": 0.0, "whole seconds": float(int(now)), "ms": 1e3 * now}[stamps]
        out += matcher.feed(pose(stamp, x=float(k)), now)
        out += matcher.feed(image(stamp), now + 0.01)
        out += matcher.release(now + 0.09)
    out += matcher.release(60.0)
    assert len(out) >= 9
    assert sum("the times of arrival are taken" in line for line in lines) == 1
    later = out[3:]
    np.testing.assert_allclose(np.diff([each.time for each in later]), 0.1, atol=1e-9)
    # Each has the pose that came with it.
    places = [each.X_WL.translation()[0] for each in later]
    np.testing.assert_allclose(np.diff(places), 1.0, atol=0.11)


@pytest.mark.parametrize("apart", [-7200.0, 1000.0])
def test_clocks_hours_apart_are_put_together_by_arrival(apart, lines):
    """The delays of both streams differ by 20 ms here, and so does the pose that is taken."""
    matcher, out = ImageMatcher(report=lines.append), []
    for k in range(40):
        now = 10.0 + 0.02 * k
        out += matcher.feed(pose(5000.0 + now + apart, x=now), now)
        if k % 10 == 9:
            out += matcher.feed(image(5000.0 + now - 0.02), now)
    out += matcher.release(20.0)
    assert len(out) == 4
    for each in out:
        assert each.X_WL.translation()[0] == pytest.approx(each.time - 5000.0, abs=0.021)
    (line,) = lines
    told = float(line.partition(" s ")[0].rpartition(" ")[2])
    assert told == pytest.approx(abs(apart), abs=0.03)
    assert ("ahead of" if apart > 0 else "behind") in line
    stated = ImageMatcher(clock_offset=apart, report=lines.append)
    for k in range(3):
        stated.feed(pose(100.0 + apart + k, x=float(k)), 0.0)
    (posed,) = stated.feed(image(101.0), 0.0)
    assert posed.X_WL.translation()[0] == 1.0


def test_another_peer_neither_pushes_the_clock_nor_takes_the_scanners_place(lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    good = []
    for k in range(30):
        now = 0.3 * k
        matcher.feed(image(1e9 * (k % 4)), now, "hostile")
        good += [p for p in matcher.feed(image(5.0 + now), now, "good") if p.sender[0] == "good"]
    assert len(good) == 30
    assert matcher.feed(image(20.0), 9.0, "late") == []
    assert len(matcher.feed(image(20.0), 12.0, "heir")) == 1


def test_pose_of_the_images_own_peer_is_preferred():
    matcher = ImageMatcher(poses="ProbeToReference")
    matcher.feed(pose(1.0, 3.0), 0.0, "tracker")
    assert matcher.feed(image(1.0), 0.0, "scanner")[0].X_WL.translation()[0] == 3.0
    matcher.feed(pose(2.0, 4.0), 1.0, "scanner")
    matcher.feed(pose(2.0, 5.0), 1.0, "tracker")
    assert matcher.feed(image(2.0), 1.0, "scanner")[0].X_WL.translation()[0] == 4.0


@pytest.mark.parametrize("asked", [None, "ProbeToTracker,TrackerToReference", "ProbeToReference"])
def test_transforms_are_composed_to_the_pose_of_the_probe(asked, lines):
    """A tracker tells probe and reference, one after the other, and the second is inverted."""
    matcher, out = ImageMatcher(poses=asked, report=lines.append), []
    turn = RotationMatrix.MakeZRotation(0.5)
    for k in range(8):
        now = 0.2 * k
        reference = RigidTransform(turn, [0.1, 0.01 * k, 0.0])
        probe = reference @ RigidTransform([0.01 * k, 0.0, 0.2])
        out += matcher.feed(PoseItem("ProbeToTracker", 5 + now, probe), now)
        out += matcher.feed(PoseItem("ReferenceToTracker", 5 + now, reference), now + 0.001)
        out += matcher.feed(image(5 + now), now + 0.002)
    out += matcher.release(5.0)
    assert len(out) == 8
    assert matcher.posed
    for k, each in enumerate(out):
        np.testing.assert_allclose(each.X_WL.translation(), [0.01 * k, 0, 0.2], atol=1e-9)
    assert any("inverse of ReferenceToTracker" in line for line in lines)


def test_other_poses_are_named_where_the_expected_one_is_missing(lines):
    matcher = ImageMatcher(report=lines.append)
    matcher.feed(pose(1.0, name="StylusToTracker"), 0.0)
    matcher.feed(image(1.0), 0.0)
    assert len(matcher.release(1.0)) == 1
    assert "there are: StylusToTracker" in lines[-1]


@pytest.mark.parametrize("restart", [5.0, 90000.0])
def test_clock_that_is_set_anew_goes_on(restart, lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    stamps = [1000.0, 1000.3, restart, restart + 0.3]
    out = [p for t in stamps for p in matcher.feed(image(t), 0.0)]
    np.testing.assert_allclose([p.time for p in out], [1000.0, 1000.3, 1000.6, 1000.9])
    assert [p.image.time for p in out] == stamps
    assert "clock jumped" in lines[-1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"origin": 1e999}',
        ACQUISITION.replace('"time":1.0', '"time":1' + 400 * "0"),
        ACQUISITION.replace("}", ',"tracker_seed":"abc"}'),
        "[" * 50000,
    ],
)
def test_text_that_makes_no_sense_is_left_out(text, lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    with pytest.raises(ValueError, match="Acquisition: "):
        matcher.feed(TextItem("Acquisition", 1.0, text), 0.0)
    assert len(matcher.feed(image(1.0), 0.0)) == 1
