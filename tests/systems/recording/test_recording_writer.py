"""What we record, read by others, by us, and after an interruption."""

import json
from dataclasses import replace

import nrrd
import numpy as np
import pytest
import SimpleITK
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from synthetic_volumes import Scene

from sonoservo.systems.recording import (
    Recording,
    RecordingWriter,
    VolumePlayer,
    VolumeRecorder,
    read_truth,
)
from sonoservo.systems.recording.side_files import TRUTH, side_path
from sonoservo.systems.signals import Needle, NotFound, PointSpread, Volume

SCENE = Scene(seed=1, spacing=2e-3)


def pose(k):
    return RigidTransform(RollPitchYaw(2.0, 0.1 * k, -0.5), [0.4 + 0.001 * k, 0.1 / 3, 0.2])


@pytest.fixture(scope="module")
def volumes():
    return [SCENE.volume(k, X_WP=pose(k)) for k in range(4)]


@pytest.fixture
def recorded(tmp_path, volumes):
    path = tmp_path / "new" / "a.seq.nrrd"
    with RecordingWriter(path, {"tracker_seed": 7}) as writer:
        for volume in volumes:
            writer.append(volume)
    return path


def assert_equal(volume, other):
    np.testing.assert_array_equal(volume.intensities, other.intensities)
    for name in ("origin", "spacing", "time", "decibels_per_level"):
        np.testing.assert_array_equal(getattr(volume, name), getattr(other, name))
    np.testing.assert_array_equal(volume.X_WP.GetAsMatrix4(), other.X_WP.GetAsMatrix4())
    if other.motion is not None:
        assert volume.motion.geometry == other.motion.geometry
        assert volume.motion.direction == other.motion.direction
        np.testing.assert_array_equal(volume.motion.times, other.motion.times)
        np.testing.assert_array_equal(volume.motion.X_WP, other.motion.X_WP)


def test_volumes_are_read_back_to_the_last_bit(recorded, volumes):
    recording = Recording(recorded)
    assert recording.posed
    assert recording.settings == {"tracker_seed": 7}
    assert len(recording) == 4
    for k, volume in enumerate(volumes):
        assert_equal(recording[k], volume)
        X_WL = recording.X_WL(k)
        assert X_WL.IsNearlyEqualTo(volume.X_WP, 1e-12)  # LPS are the axes of P, `write_volume`
    assert {path.name for path in recorded.parent.iterdir()} == {
        "a.seq.nrrd",
        "a.acquisition.jsonl",
    }


def test_others_read_the_same_voxels_at_the_same_millimetre(recorded, volumes):
    index = (20, 30, 12)
    place = 1e3 * volumes[2].position(index)
    image = SimpleITK.ReadImage(str(recorded))
    assert image.GetSize() == volumes[2].intensities.shape
    np.testing.assert_allclose(image.TransformIndexToPhysicalPoint(index), place)
    assert image[index][2] == volumes[2].intensities[index]
    data, header = nrrd.read(str(recorded))
    np.testing.assert_array_equal(data[..., 2], volumes[2].intensities)
    assert header["kinds"] == ["domain", "domain", "domain", "list"]
    assert header["labels"] == ["", "", "", "time"]
    np.testing.assert_allclose(
        header["space origin"] + index @ header["space directions"][:3], place
    )
    times = [float(time) for time in header["axis 3 index values"].split()]
    assert times == [volume.time for volume in volumes]


def test_of_an_interrupted_recording_everything_written_is_there(tmp_path, volumes):
    path = tmp_path / "a.seq.nrrd"
    writer = RecordingWriter(path)  # not closed, as by a program that is killed
    for volume in volumes[:3]:
        writer.append(volume)
    assert not path.exists()
    partial = tmp_path / "a.partial.seq.nhdr"
    data, _ = nrrd.read(str(partial))
    assert data.shape[3] == 3
    for volume, original in zip(Recording(partial), volumes[:3], strict=True):
        np.testing.assert_array_equal(volume.intensities, original.intensities)
        assert volume.time == original.time


def test_nothing_recorded_leaves_nothing(tmp_path):
    with RecordingWriter(tmp_path / "a.seq.nrrd"):
        pass
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_recorded_is_refused(tmp_path, volumes):
    with pytest.raises(ValueError, match=r"must end in \.seq\.nrrd"):
        RecordingWriter(tmp_path / "a.nrrd")
    writer = RecordingWriter(tmp_path / "a.seq.nrrd")
    writer.append(volumes[0])
    with pytest.raises(ValueError, match="differs"):
        writer.append(Scene(seed=1, spacing=3e-3).volume(1))
    with pytest.raises(ValueError, match="differs"):
        writer.append(replace(volumes[1], decibels_per_level=0.1))


def test_resolution_and_unknown_motion_are_read_back_exactly(tmp_path, volumes):
    spread = PointSpread([0.0, 0.01 / 3, 0.09], [1e-3 / 3, 2e-3, 3e-3], [4e-3] * 3, [0.4e-3] * 3)
    array = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32) * 255
    volume = Volume(array, [0.1, 0.2, 0.3], [1e-3, 2e-3, 3e-3], pose(1), 1 / 3, None, 0.1, spread)
    path = tmp_path / "a.seq.nrrd"
    with RecordingWriter(path) as writer:
        writer.append(volume)
        with pytest.raises(ValueError, match="differs"):
            writer.append(replace(volume, point_spread=None))
    (read,) = Recording(path)
    assert_equal(read, volume)
    assert read.motion is None
    for name in ("depth", "lateral", "elevation", "axial"):
        np.testing.assert_array_equal(getattr(read.point_spread, name), getattr(spread, name))


@pytest.mark.parametrize(
    ("older", "decibels"), [({"dynamic_range_db": 50.0}, 50), ({}, 60), (None, 60)]
)
def test_older_recordings_told_their_range_or_nothing(recorded, volumes, older, decibels):
    side = recorded.with_name("a.acquisition.jsonl")
    first, *lines = side.read_text().splitlines()
    kept = {key: value for key, value in json.loads(first).items()
            if key not in ("decibels_per_level", "point_spread")}  # fmt: skip
    side.write_text("\n".join([json.dumps(kept | (older or {})), *lines, ""]))
    if older is None:
        side.unlink()
    for volume, original in zip(Recording(recorded), volumes, strict=True):
        np.testing.assert_array_equal(volume.intensities, original.intensities)
        assert volume.time == original.time
        assert volume.X_WP.IsNearlyEqualTo(original.X_WP, 1e-12)
        np.testing.assert_allclose(volume.origin, original.origin, atol=1e-12)
        assert (volume.motion is None) == (older is None)
        assert volume.decibels_per_level == decibels / 255
        assert volume.point_spread is None
    assert Recording(recorded, dynamic_range_db=72.0)[0].decibels_per_level == 72 / 255


def test_a_recorder_and_a_player_as_systems(tmp_path, volumes):
    path = tmp_path / "a.seq.nrrd"
    recorder = VolumeRecorder(path=path, period=0.1, truth_period=0.05)
    context = recorder.CreateDefaultContext()
    X_WT = RigidTransform([0, 0, 0.5])
    for name, value in (
        ("volume", Value[object](NotFound("no sweep"))),
        ("needle", Value[object](Needle([[0, 0, 0], [0.03, 0, 0], [0.03, 0.04, 0]], 5e-4))),
        ("X_WT", Value(X_WT)),
    ):
        recorder.GetInputPort(name).FixValue(context, value)
    recorder.GetInputPort("contact_force").FixValue(context, [2.5])
    simulator = Simulator(recorder, context)
    simulator.AdvanceTo(0.15)
    for k, volume in enumerate(volumes):
        recorder.GetInputPort("volume").FixValue(context, Value[object](volume))
        simulator.AdvanceTo(0.15 + 0.2 * (k + 1))  # each is looked at twice, and written once
    recorder.close()

    truth = read_truth(side_path(path, TRUTH))
    np.testing.assert_allclose(truth.times, np.arange(20) * 0.05, atol=1e-12)
    needle = truth.needles[truth.at(0.41)]
    np.testing.assert_allclose(needle.tip, [0.03, 0.04, 0.5])
    assert needle.length == pytest.approx(0.07)
    np.testing.assert_allclose(truth.contact_force, 2.5)

    player = VolumePlayer(recording=Recording(path), start=1.0, delay=0.05)
    assert player.end == pytest.approx(1.05 + volumes[3].time - volumes[0].time)
    playing = player.CreateDefaultContext()
    port = player.GetOutputPort("volume")
    assert not port.Eval(playing)
    for time, number in ((1.0, None), (1.05, 0), (1.05 + 0.29, 0), (1.05 + 0.31, 1), (99.0, 3)):
        playing.SetTime(time)
        shown = port.Eval(playing)
        if number is None:
            assert isinstance(shown, NotFound)
        else:
            assert_equal(shown, volumes[number])
            assert port.Eval(playing) is shown
    playing.SetTime(1.05)
    assert_equal(port.Eval(playing), volumes[0])


def recording_of(recorder, volumes, context=None):
    """Simulate a run in which each of the volumes comes."""
    simulator = Simulator(recorder, context or recorder.CreateDefaultContext())
    for k, volume in enumerate(volumes):
        recorder.GetInputPort("volume").FixValue(
            simulator.get_mutable_context(), Value[object](volume)
        )
        simulator.AdvanceTo(0.2 * (k + 1))
    return simulator


def test_a_run_that_starts_anew_records_anew(tmp_path, volumes):
    path = tmp_path / "a.seq.nrrd"
    recorder = VolumeRecorder(path=path, period=0.1)
    recording_of(recorder, volumes)  # never closed
    recording_of(recorder, volumes[:2])
    recorder.close()
    assert [each.time for each in Recording(path)] == [each.time for each in volumes[:2]]
    simulator = recording_of(recorder, volumes[:3])  # the same times again
    recorder.close()
    assert [each.time for each in Recording(path)] == [each.time for each in volumes[:3]]
    simulator.get_mutable_context().SetTime(0.0)
    recording_of(recorder, volumes[1:], simulator.get_mutable_context())
    recorder.close()
    assert [each.time for each in Recording(path)] == [each.time for each in volumes[1:]]
    assert {each.name for each in tmp_path.iterdir()} == {"a.seq.nrrd", "a.acquisition.jsonl"}


def test_damaged_side_files_are_one_line(recorded):
    side = recorded.with_name("a.acquisition.jsonl")
    lines = side.read_text().splitlines()
    later = json.loads(lines[-1])
    later["time"] += 0.5
    for text, message in (
        ("", "damaged"),
        ("{}\n", "damaged"),
        ("\n".join([lines[0].replace('"format": 1', '"format": 9'), *lines[1:], ""]), "format 9"),
        ("\n".join([*lines[:3], ""]), "does not belong to the recording"),
        ("\n".join([*lines[:-1], json.dumps(later), ""]), "its volumes are others"),
        ("\n".join([lines[0], *[json.dumps({"time": 1})] * 4, ""]), "damaged"),
    ):
        side.write_text(text)
        with pytest.raises(ValueError, match=message) as error:
            Recording(recorded)
        assert str(side) in str(error.value)
