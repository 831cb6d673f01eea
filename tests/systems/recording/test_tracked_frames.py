import re

import numpy as np
import pytest
from tracked_frames import freehand, write_plus_file

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.tracked_frames import TrackedFrames


@pytest.fixture(scope="module")
def frames():
    return freehand(6, dtype=np.uint8)


def test_invalid_frames_are_left_out(tmp_path, frames):
    read = TrackedFrames(write_plus_file(tmp_path / "f.mha", frames, bad=(0, 3)))
    assert (len(read), read.skipped) == (4, 2)
    np.testing.assert_array_equal(read[0], frames[1].pixels)


def test_fields_beyond_the_last_frame_are_told(tmp_path, frames):
    """After a cut, the fields of the frames that were cut off are left."""
    path = write_plus_file(tmp_path / "f.mha", frames)
    path.write_bytes(path.read_bytes().replace(b"DimSize = 40 50 6", b"DimSize = 40 50 4"))
    read = TrackedFrames(path)
    np.testing.assert_allclose(read.X_WI, [frame.X_WI for frame in frames[:4]], atol=1e-9)
    note = "Seq_Frame0005_ImageToReferenceTransform has no effect: the file holds 4 frames"
    assert any(each.startswith(note) for each in read.notes)


@pytest.mark.parametrize("first", [1, 100])
def test_frames_counted_from_another_number_are_refused(tmp_path, frames, first):
    path = write_plus_file(tmp_path / "f.mha", frames)
    header, begin, data = path.read_bytes().partition(b"ElementDataFile")
    header = re.sub(rb"(?<=Frame)\d{4}", lambda each: b"%04d" % (int(each[0]) + first), header)
    path.write_bytes(header + begin + data)
    named = rf"Seq_Frame{first:04d}_\w+ to Seq_Frame{first + 5:04d}_\w+"
    with pytest.raises(ConfigurationError, match=f"{named}: the file holds 6 frames, counted from"):
        TrackedFrames(path)


def test_pose_of_a_probe_uses_the_spacing_of_the_header(tmp_path, frames):
    path = write_plus_file(tmp_path / "f.mha", frames, name="ProbeToReference")
    text = path.read_bytes().replace(b"ElementSpacing = 1 1 1", b"ElementSpacing = 2 3 1")
    path.write_bytes(text)
    read = TrackedFrames(path)
    np.testing.assert_allclose(read.X_WI[0][:3, 0], 2 * frames[0].X_WI[:3, 0], atol=1e-12)
    np.testing.assert_allclose(read.X_WI[0][:3, 1], 3 * frames[0].X_WI[:3, 1], atol=1e-12)


def test_volumes_are_no_frames(tmp_path, frames):
    path = write_plus_file(tmp_path / "f.mha", frames)
    path.write_bytes(path.read_bytes().replace(b"DimSize = 40 50 6", b"DimSize = 40 1 300"))
    with pytest.raises(ConfigurationError, match="not 2D frames"):
        TrackedFrames(path)


@pytest.mark.parametrize("stamp", [b"10.00", b"x", b"99"])
def test_a_time_out_of_order_costs_its_frame(tmp_path, frames, stamp):
    path = write_plus_file(tmp_path / "f.mha", frames)
    old = b"Frame0001_Timestamp = 10.050000"
    path.write_bytes(path.read_bytes().replace(old, b"Frame0001_Timestamp = " + stamp))
    read = TrackedFrames(path)
    assert (len(read), read.skipped) == (5, 1)
    assert not set(read.times) >= {10.0, 10.05}
    assert "left out 1 frame: 1 " in read.notes[-1]


def test_pose_that_is_none_costs_its_frame(tmp_path, frames):
    path = write_plus_file(tmp_path / "f.mha", frames)
    lines = path.read_bytes().split(b"\n", 40)
    lines = [
        line.split(b"=")[0] + b"= " + b"0 " * 16
        if line.startswith(b"Seq_Frame0002_ImageToReferenceTransform ")
        else line
        for line in lines
    ]
    path.write_bytes(b"\n".join(lines))
    read = TrackedFrames(path)
    assert read.notes[-1] == "left out 1 frame: 1 whose pose is no transform (2)"
    np.testing.assert_array_equal(read[2], frames[3].pixels)
