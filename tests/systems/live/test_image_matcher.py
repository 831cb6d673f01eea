import numpy as np
import pytest
from live_items import X, make_volume
from pydrake.math import RigidTransform

from sonoservo.systems.live.connection.items import ImageItem, PoseItem, TextItem
from sonoservo.systems.live.image_matcher import ImageMatcher
from sonoservo.systems.live.volume_sender import volume_items


def image(time, name="Image", shape=(4, 3, 2)):
    return ImageItem(name, time, np.zeros(shape, np.uint8), np.eye(4))


def pose(time, x=0.0, name="ProbeToReference"):
    return PoseItem(name, time, RigidTransform([x, 0, 0]))


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


def test_pose_with_the_same_stamp_is_enough(matcher):
    matcher.feed(pose(1.0, 0.5), 0.0)
    (posed,) = matcher.feed(image(1.0), 0.0)
    assert posed.X_WL.translation()[0] == 0.5


def test_image_does_not_wait_for_ever(matcher, lines):
    matcher.feed(pose(1.0), 0.0)
    assert matcher.feed(image(1.03), 0.03) == []
    assert len(matcher.release(0.2)) == 1
    matcher.feed(image(2.0), 1.0)
    assert matcher.release(1.2) == []
    assert matcher.left_out == 1
    assert "the nearest pose is 1.000 s away" in lines[-1]


def test_without_poses_the_probe_is_at_rest(lines):
    matcher = ImageMatcher(report=lines.append)
    assert matcher.feed(image(1.0), 0.0) == []
    assert len(matcher.release(0.6)) == 1
    assert "'ProbeToReference'" in lines[-1]
    matcher.feed(pose(2.0, 9.0), 1.0)  # too late: the world does not change any more
    (posed,) = matcher.feed(image(2.0), 1.0)
    assert posed.X_WL.IsExactlyEqualTo(RigidTransform())
    assert not matcher.posed


def test_poses_of_another_device_count_only_where_they_are_named():
    matcher = ImageMatcher(poses="Arm")
    matcher.feed(pose(1.0, 3.0, "Arm"), 0.0)
    matcher.feed(pose(1.0, 4.0), 0.0)
    (posed,) = matcher.feed(image(1.0), 0.0)
    assert posed.X_WL.translation()[0] == 3.0


def test_poses_none_leaves_them_out():
    matcher = ImageMatcher(poses="none")
    matcher.feed(pose(1.0, 3.0), 0.0)
    (posed,) = matcher.feed(image(1.0), 0.0)
    assert posed.X_WL.IsExactlyEqualTo(RigidTransform())


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
    assert matcher.left_out == 2
    assert "is not later than the last one's" in lines[-1]


@pytest.mark.parametrize("restart", [5.0, 90000.0])
def test_clock_that_is_set_anew_goes_on(restart, lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    stamps = [1000.0, 1000.3, restart, restart + 0.3]
    out = [p for t in stamps for p in matcher.feed(image(t), 0.0)]
    np.testing.assert_allclose([p.time for p in out], [1000.0, 1000.3, 1000.6, 1000.9])
    assert [p.image.time for p in out] == stamps
    assert "clock jumped" in lines[-1]


def test_scanner_of_this_package_tells_the_pose_exactly():
    matcher = ImageMatcher()
    volume = make_volume(1000.3)
    text, _, picture = volume_items(volume, settings={"dynamic_range_db": 55})
    matcher.feed(text, 0.0)
    (posed,) = matcher.feed(picture, 0.0)
    assert posed.X_WL.IsExactlyEqualTo(X)
    assert posed.time == 1000.3
    assert posed.acquisition.settings == {"dynamic_range_db": 55}


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"time": "x"}', '{"origin": 1e999}'])
def test_text_that_makes_no_sense_is_left_out(text, lines):
    matcher = ImageMatcher(poses="none", report=lines.append)
    matcher.feed(TextItem("Acquisition", 1.0, text), 0.0)
    assert "a text is left out" in lines[-1]
    assert len(matcher.feed(image(1.0), 0.0)) == 1


def test_images_that_wait_are_bounded(matcher):
    for k in range(1000):
        matcher.feed(image(1e4 + k), 0.0)
    assert len(matcher._waiting) <= 32
