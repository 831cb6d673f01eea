"""What a run keeps to explain its estimates, and the command that draws it."""

import json
import re
from shutil import copytree

import numpy as np
import pytest
from commands import sonoservo_here

from sonoservo.diagrams import load_scenario, run, track_recording
from sonoservo.diagrams.app.kept_runs.explain import explanation_table, read_explained_run
from sonoservo.systems.evaluation import read_explanations
from sonoservo.systems.evaluation.explanation.explained_volume import FOLDER
from sonoservo.systems.evaluation.log import columns
from sonoservo.systems.recording import Recording

CHANGES = [
    "duration=5.8",
    "hand.start=0.5",
    "hand.pushes=[{duration: 3.0, speed: 0.016}, {duration: 6.0, speed: -0.03}]",
    "scan_conversion.spacing=[1e-3, 1e-3, 1e-3]",
]
"""The needle is pushed in, and pulled out again."""


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A run that loses its needle, and the folder with its explanations and its recording."""
    out = tmp_path_factory.mktemp("explained") / "out"
    scenario = load_scenario("chatelain2013_fig4", seed=101, changes=CHANGES)
    return out, run(scenario, out=out, explain=True, record=out / "a.seq.nrrd")


def test_the_volumes_around_each_change_are_kept_with_the_truth_apart(kept):
    out, result = kept
    explained = read_explained_run(out)
    log = result.log
    changes = log.volume_time[1:][log.volume_estimate_mode[1:] != log.volume_estimate_mode[:-1]]
    times = np.array([each.volume_time for each in explained.kept])
    assert len(changes) >= 2  # found, and withdrawn
    assert set(changes) <= set(times) <= set(log.volume_time)
    assert len(times) < len(log.volume_time)
    for row, volume in zip(explained.rows(), explained.kept, strict=True):
        (number,) = np.flatnonzero(log.volume_time == volume.volume_time)
        assert row["mode_after"] == log.volume_estimate_mode[number]
        measured = log.volume_measured_tip[number]
        assert len(volume.measured) == np.isfinite(measured).all() * 2
        if len(volume.measured):
            np.testing.assert_array_equal(volume.measured[-1], measured)
            assert row["innovation"] < row["gate"] or np.isnan(row["innovation"]) or row["reason"]
    assert any(row["occasion"] == "searching to tracking" for row in explained.rows())


def test_a_recording_is_explained_as_the_run_was(kept, tmp_path):
    out, _ = kept
    track_recording(Recording(out / "a.seq.nrrd"), out=tmp_path, explain=True)
    there, here = read_explanations(out), read_explanations(tmp_path)
    assert len(there) == len(here)
    for before, after in zip(there, here, strict=True):
        for name in columns(type(before)):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    errors = [row["tip_error_mm"] for row in read_explained_run(tmp_path).rows()]
    assert np.nanmedian(errors) < 3


def test_the_command_lists_and_draws(kept, tmp_path):
    out, _ = kept
    listed = sonoservo_here("explain", str(out), "--json", str(tmp_path / "rows.json"))
    assert listed.returncode == 0
    assert "searching → tracking" in " ".join(listed.stdout.split())
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert len(rows) == len(read_explanations(out))
    assert explanation_table(read_explained_run(out).rows()).row_count == len(rows)
    row = next(row for row in rows if row["reason"] == "the needle was withdrawn")
    picture = tmp_path / "a.png"
    time = row["time_s"] + 0.01
    options = ["--time", time, "--out", picture, "--json", tmp_path / "row.json"]
    drawn = sonoservo_here("explain", str(out), *map(str, options))
    assert drawn.returncode == 0
    assert row["reason"] in " ".join(drawn.stdout.split())
    assert f"Nothing was kept at {time:.2f} s; this is {row['time_s']:.2f} s" in drawn.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "row.json").read_text()) == row
    again = sonoservo_here("explain", str(out), "--time", str(row["time_s"]))
    assert "Nothing was kept" not in again.stdout
    assert (out / f"explanation_{row['time_s']:.2f}s.png").is_file()


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("nowhere", [], "there is no folder .*nowhere; make it: sonoservo run .* --explain"),
        ("a.nrrd", [], "is no folder of results; make one: sonoservo track .*a.nrrd --explain"),
        ("plain", [], "repeat the run: sonoservo run .*plain/scenario.yaml --explain$"),
        ("quiet", [], "nothing happened that was to be explained"),
        ("out", ["--time", "nan"], r"time: nan s is outside; .* from \d+\.\d+ to \d+\.\d+ s"),
    ],
)
def test_a_mistake_is_one_line_that_says_what_to_do(kept, tmp_path, name, arguments, message):
    (tmp_path / "plain").mkdir()
    (tmp_path / "a.nrrd").touch()
    (tmp_path / "plain" / "scenario.yaml").touch()
    (tmp_path / "quiet" / FOLDER).mkdir(parents=True)
    folder = kept[0] if name == "out" else tmp_path / name
    result = sonoservo_here("explain", str(folder), *arguments)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert re.search(message, line)


def test_without_the_log_the_truth_is_not_known(kept, tmp_path):
    copytree(kept[0] / FOLDER, tmp_path / FOLDER)
    explained = read_explained_run(tmp_path)
    assert np.isnan([row["tip_error_mm"] for row in explained.rows()]).all()
    assert "truth" not in str(
        explained.sheet(explained.kept[-1]).axes[0].get_legend_handles_labels()
    )
