"""Logs for viewers, opened by the viewers' own libraries and compared with the run's log."""

import io
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from rerun.chunk import RrdReader
from synthetic_logs import build_insertion_log

from sonoservo.systems.evaluation import features
from sonoservo.systems.evaluation.viewer_logs import (
    Surroundings,
    open_viewer_log,
    write_run,
    write_volume,
)
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals import NeedleEstimate, TrackingMode


@pytest.fixture(scope="module")
def run():
    return build_insertion_log()


def written(path, run, volume):
    log = open_viewer_log(path)
    write_volume(log, volume, NeedleEstimate(TrackingMode.SEARCHING, 0.5))
    write_run(log, run, Surroundings(sector=[np.eye(3)], arm_points=None))
    log.close()
    return path


@pytest.fixture
def volume(make_volume):
    return make_volume(lambda p: 100 + 1e3 * p[..., 0])


def columns(path, entity):
    """Times in s and values of an entity of a recording of Rerun, by component."""
    times, values = [], {}
    for chunk in RrdReader(str(path)).stream():
        if chunk.entity_path != f"/{entity}" or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            column = batch.column(name)
            if name == "time":
                times += [each.total_seconds() for each in column.to_pylist()]
            elif ":" in name:
                values.setdefault(name.split(":")[-1], []).extend(column.to_pylist())
    return np.array(times), values


def test_rerun_opens_its_file_with_the_values_of_the_log(run, volume, tmp_path):
    path = written(tmp_path / "run.rrd", run, volume)
    times, force = columns(path, "force/contact")
    np.testing.assert_allclose(times, run.time, atol=1e-6)
    np.testing.assert_allclose(np.ravel(force["scalars"]), run.contact_force)
    _, pose = columns(path, "world/probe")
    moved = np.array(pose["translation"]).reshape(-1, 3)
    np.testing.assert_allclose(moved, run.X_WP[:, :3, 3], atol=1e-6)
    turned = np.array(pose["mat3x3"]).reshape(-1, 3, 3).transpose(0, 2, 1)
    np.testing.assert_allclose(turned, run.X_WP[:, :3, :3], atol=1e-6)
    _, needle = columns(path, "world/needle/true")
    last = np.array(needle["strips"][-1]).reshape(-1, 3)
    np.testing.assert_allclose(last, run.needle_points[-1], atol=1e-6)
    _, modes = columns(path, "mode")
    assert [each[0] for each in modes["text"]] == ["searching", "tracking"]
    assert columns(path, "volume")[0].tolist() == [volume.time]
    assert columns(path, "slices/along")[0].tolist() == [volume.time]


def test_mcap_opens_its_file_with_the_values_of_the_log(run, volume, tmp_path):
    path = written(tmp_path / "run.mcap", run, volume)
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            factory = DecoderFactory().decoder_for(channel.message_encoding, schema)
            value = factory(message.data) if factory else message.data
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, value))
    times = np.array([each[0] for each in found["/force/contact"]]) * 1e-9
    np.testing.assert_allclose(times, run.time, atol=1e-8)
    assert found["/force/contact"][-1][2] == b'{"value": 2.0}'
    wanted = features(run.X_WP, run.needle_tip, run.needle_entry)[:, 0]
    assert len(found["/features/true/x"]) == np.isfinite(wanted).sum()
    _, name, pose = found["/tf"][-1]
    assert name == "foxglove.FrameTransform"
    assert (pose.parent_frame_id, pose.child_frame_id) == ("world", "probe")
    assert pose.translation.x == run.X_WP[-1, 0, 3]
    _, name, scene = found["/needle/true"][-1]
    assert name == "foxglove.SceneUpdate"
    points = [(p.x, p.y, p.z) for p in scene.entities[0].lines[0].points]
    np.testing.assert_allclose(points, run.needle_points[-1])
    _, _, grid = found["/volume"][0]
    grey = np.frombuffer(grid.data, np.uint8).reshape(volume.intensities.shape[::-1])
    np.testing.assert_array_equal(grey.transpose(2, 1, 0), volume.intensities)
    assert grid.cell_size.x == volume.spacing[0]
    _, _, image = found["/slices/along"][0]
    assert np.asarray(Image.open(io.BytesIO(image.data))).max() > 0
    assert [each[2].message for each in found["/mode"]] == ["searching", "tracking"]


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"must end in \.rrd or \.mcap"):
        open_viewer_log(tmp_path / "run.bag")


@pytest.mark.parametrize(("module", "name"), [("rerun", "x.rrd"), ("foxglove", "x.mcap")])
def test_without_the_package_a_line_says_what_to_install(module, name, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, module, None)
    extra = "mcap" if module == "foxglove" else module
    with pytest.raises(ConfigurationError, match=rf"pip install 'sonoservo\[{extra}\]'"):
        open_viewer_log(tmp_path / name)
