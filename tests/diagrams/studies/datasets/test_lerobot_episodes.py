"""Episodes in LeRobot's layout, against its documentation and, if there is one, its loader."""

import io
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from sonoservo.diagrams import FollowingExperiment, load_scenario
from sonoservo.diagrams.studies.datasets.lerobot_episodes import episode_frames, make_episodes

CHANGES = ["duration=1.3", "scan_conversion.spacing=[2e-3, 2e-3, 2e-3]", "tracker=zhao2012"]


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("chatelain2013_fig5", changes=CHANGES, seed=100)


@pytest.fixture(scope="module")
def folder(scenario, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lerobot")
    make_episodes(scenario, folder, count=2, jobs=1)
    return folder


def test_frames_are_those_of_the_run(folder, scenario):
    experiment = FollowingExperiment(scenario)
    experiment.run()
    log = experiment.log()
    table = pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
    first = np.array(table["episode_index"]) == 0
    assert first.sum() == len(log.volume_time)
    for name, wanted in episode_frames(log, scenario).items():
        np.testing.assert_array_equal(np.array(table[name], np.float32)[first], wanted)
    assert np.array(table["action"])[0, 3] == 2.0
    with Image.open(io.BytesIO(table["observation.images.along"][0]["bytes"])) as image:
        assert image.mode == "RGB"
        assert np.asarray(image).max() > 0


def test_the_layout_is_that_of_the_documentation(folder):
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    data = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(data.column_names) == set(info["features"])
    assert data.num_rows == info["total_frames"]
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["dataset_from_index"] == [0, episodes["length"][0]]
    assert episodes["dataset_to_index"][-1] == info["total_frames"]
    steps = np.array(data.column("timestamp"))[:2] * info["fps"]
    np.testing.assert_allclose(steps, [0, 1], atol=1e-5)
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert stats["action"]["max"][3] == 2.0


def test_the_loader_of_lerobot_reads_it(folder):
    module = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    loaded = module.LeRobotDataset("sonoservo/episodes", root=folder)
    table = pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
    assert loaded.num_episodes == 2
    np.testing.assert_allclose(loaded[1]["action"], table["action"][1])
    assert loaded[1]["task"].startswith("Follow the needle")
