"""The benchmark: scores against what is known, tables, entrants, and one short sequence."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from commands import sonoservo_here
from pydrake.math import RigidTransform

from sonoservo.diagrams.benchmark import benchmark
from sonoservo.diagrams.benchmark.benchmark import ALL, BenchmarkOptions, run_benchmark
from sonoservo.diagrams.benchmark.entrants import resolve_entrant, start_tracker
from sonoservo.diagrams.benchmark.estimates import (
    Estimated,
    estimates_text,
    parse_estimates,
    read_estimates,
)
from sonoservo.diagrams.benchmark.making import make_volumes
from sonoservo.diagrams.benchmark.report import kept_markdown, write_benchmark
from sonoservo.diagrams.benchmark.scores import judge_sequence, reliability, score
from sonoservo.diagrams.benchmark.sequence import acquire_sequence, load_suites, sequence_seeds
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.recording.side_files import read_truth
from sonoservo.systems.signals.volume import Volume

SEED = 107


@pytest.fixture(scope="module")
def sequence():
    """Sequence of the suite clean that ends a second after its forced loss."""
    settings = load_suites()["clean"].settings()
    settings["changes"] = [
        *settings["changes"],
        "hand.start=0.0",
        "hand.pushes=[{duration: 1.667, speed: 0.03}, {duration: 3.0, speed: 0.005}]",
        "scan_conversion.spacing=[1.5e-3, 1.5e-3, 1.5e-3]",
    ]
    return acquire_sequence(settings, SEED)


@pytest.fixture(scope="module")
def truth(sequence):
    """Rows that state the true needle in the volumes that show it."""
    log, rows = sequence.truth, []
    for number, volume in enumerate(sequence.volumes):
        nearest = int(np.abs(log.time - volume.time).argmin())
        points = log.needle_points[nearest]
        in_probe = RigidTransform(log.X_WP[nearest]).inverse().multiply(points.T).T
        seen = np.isfinite(points).all() and log.visible_length[nearest] > 5e-3
        lifted = sequence.lifted[0] < volume.time < sequence.lifted[1]
        nowhere = np.full(3, np.nan)
        if seen and not lifted:
            rows.append(Estimated(number, in_probe[-1], in_probe[4], "tracking", volume.time, 0.9,
                                  1e-6 * np.eye(3), 7.0))  # fmt: skip
        else:
            rows.append(Estimated(number, nowhere, nowhere, "searching"))
    return rows


def judged(sequence, rows):
    times = [(each.time, each.X_WP) for each in sequence.volumes]
    return judge_sequence(sequence.truth, times, sequence.lifted, rows)


def deeper(rows, depth):
    """Return rows with needles that lie deeper, in m."""
    down = np.array([0, depth, 0])
    return [replace(each, tip=each.tip + down, entry=each.entry + down) for each in rows]


def test_the_probe_is_lifted_and_comes_back(sequence):
    level = {each.time: float(each.intensities.mean()) for each in sequence.volumes}
    up, down = sequence.lifted
    dark = [grey for time, grey in level.items() if up + 0.6 < time < down - 0.6]
    lit = [grey for time, grey in level.items() if time < up - 0.2 or time > down + 0.3]
    assert dark
    assert max(dark) < 0.1 * min(lit)


def test_the_truth_has_no_errors(sequence, truth):
    record = judged(sequence, truth)
    assert record["found"]
    assert record["reacquired"]
    assert record["false_finds"] == 0
    assert None not in record["tip_mm"]
    assert max(record["tip_mm"]) < 0.5
    assert all(record["kept"])
    assert all(record["inside"])
    assert set(record["process_ms"]) == {7.0}
    assert record["stated"] == [[0.9, True]] * len(record["stated"])
    assert record["seconds"] == pytest.approx(sequence.lifted[1] + 4, abs=0.05)


def test_errors_are_those_that_are_put_in(sequence, truth):
    record = judged(sequence, deeper(truth, 3e-3))
    assert np.median(record["tip_mm"]) == pytest.approx(3, abs=0.2)
    assert not any(record["inside"])
    backwards = [replace(each, tip=each.entry, entry=each.tip) for each in truth]
    assert not judged(sequence, backwards)["found"]


def test_what_is_beside_the_needle_is_a_false_find_and_a_missing_row_an_infinite_error(
    sequence, truth
):
    record = judged(sequence, deeper(truth, 15e-3))
    assert record["false_finds"] >= 1
    assert not any(right for _, right in record["stated"])
    assert record["found"] is False
    assert judged(sequence, [])["tip_mm"] == [None] * len(record["tip_mm"])
    lost = [each for each in truth if sequence.volumes[each.volume].time < sequence.lifted[0]]
    assert judged(sequence, lost)["reacquired"] is False


def test_figures_have_the_intervals_of_the_statistics():
    plain = {
        "found": True, "delay_s": 1.0, "kept": [True] * 9 + [False], "false_finds": 0,
        "seconds": 360.0, "reacquired": True, "stated": [[0.9, True]] * 9 + [[0.9, False]],
        "inside": [True] * 19 + [False], "process_ms": [5.0], "tip_mm": [1.0, None],
        "axis_deg": [1.0],
    }  # fmt: skip
    figures = score([plain] * 10)
    assert figures["found"]["text"] == "10 of 10"
    assert figures["found"]["low"] == pytest.approx(0.722, abs=1e-3)  # Wilson
    assert figures["false_finds_per_hour"]["high"] == pytest.approx(3.69, abs=0.01)  # Garwood, 1 h
    assert figures["kept"]["value"] == pytest.approx(90)
    assert figures["inside"]["value"] == pytest.approx(95)
    assert figures["tip_mm"]["value"] == 1.0
    assert figures["tip_p95_mm"]["text"].startswith("∞")
    (point,) = reliability([plain] * 10)
    assert (point["stated"], point["share"], point["volumes"]) == (pytest.approx(0.9), 0.9, 100)
    assert figures["delay_s"]["value"] == 1.0
    nothing = {**plain, "found": None, "reacquired": None, "tip_mm": [], "axis_deg": []}
    assert score([nothing])["found"]["text"] == "–"


def test_a_table_reads_back_what_was_written(truth, tmp_path):
    (tmp_path / "x.csv").write_text(estimates_text(truth))
    again = read_estimates(tmp_path, "x")
    for ours, theirs in zip(truth, again, strict=True):
        assert bool(ours) == bool(theirs)
        assert (ours.mode, ours.probability) == (theirs.mode, theirs.probability)
        if ours:
            np.testing.assert_allclose(ours.tip, theirs.tip)
            np.testing.assert_allclose(ours.covariance, theirs.covariance)
    assert read_estimates(tmp_path, "y") == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("volume,tip_l_mm\n0,1\n", "the columns tip_p_mm"),
        ("{head}\n0,1,x,1,1,1,1\n", "row 1: tip_p_mm: 'x' is not a finite number"),
        ("{head}\n1.5,1,1,1,1,1,1\n", "volume: it must be a whole number"),
        ("{head}\n1,1,1,1,1,1,1\n0,1,1,1,1,1,1\n", "do not rise"),
        ("{head},probability\n0,1,1,1,1,1,1,2\n", "probability: 2.0 is not from 0 to 1"),
        ("{head},mode\n0,1,1,1,1,1,1,seen\n", "mode: 'seen'"),
    ],
)
def test_a_wrong_table_is_refused_with_its_place(text, said):
    head = "volume,tip_l_mm,tip_p_mm,tip_s_mm,entry_l_mm,entry_p_mm,entry_s_mm"
    with pytest.raises(ConfigurationError, match=said):
        parse_estimates(text.replace("{head}", head), "mine.csv")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("chatelain2031", "chatelain2013"),
        ("nosuch:make", "there is no module 'nosuch'"),
        ("no.such:make", "ModuleNotFoundError"),
        ("math:pi", "not a function"),
    ],
)
def test_an_unknown_tracker_is_refused(name, said):
    with pytest.raises(ConfigurationError, match=said):
        resolve_entrant(name, {})


def test_the_brightest_line_is_the_one_that_came():
    step = start_tracker(resolve_entrant("brightest_line", {}), 0)
    rng = np.random.default_rng(3)
    grey = rng.rayleigh(10, (80, 60, 40)).clip(0, 255)
    origin = np.array([-0.04, 0, -0.02])

    def after(grey, time):
        return step(Volume(grey.astype(np.uint8), origin, [1e-3] * 3, RigidTransform(), time))

    assert not after(grey, 0.0)
    grey[10:45, 29:32, 18:21] = 120
    estimate = after(grey, 0.3)
    np.testing.assert_allclose(
        estimate.curve.tip, np.add(origin, [0.0445, 0.030, 0.019]), atol=4e-3
    )
    assert estimate.curve.direction[0] == pytest.approx(1, abs=1e-2)


def test_seeds_follow_from_the_salt():
    assert list(sequence_seeds(count=3)) == [0, 1, 2]
    assert list(sequence_seeds(7, 2)) == [7000, 7001]
    with pytest.raises(ConfigurationError, match="salt"):
        BenchmarkOptions(folder=".", salt=-1).cases()
    names = {each.experiment for each in BenchmarkOptions(folder=".", quick=True).cases()}
    assert len(names) == 14


@pytest.fixture
def short(sequence, monkeypatch):
    """Let every sequence be the one of these tests."""
    monkeypatch.setattr(benchmark, "acquire_sequence", lambda settings, seed: sequence)
    monkeypatch.setattr("sonoservo.diagrams.benchmark.making.acquire_sequence",
                        lambda settings, seed: sequence)  # fmt: skip


def test_a_folder_of_tables_is_scored_and_reported(short, truth, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "clean_seed9000.csv").write_text(estimates_text(truth[:-3]))
    options = BenchmarkOptions(folder=tmp_path / "out", suites=["clean"], quick=True, salt=9,
                               jobs=1)  # fmt: skip
    result = run_benchmark([str(mine)], options)
    scores = result.data["scores"]["mine"][ALL]
    assert scores["found"]["text"] == "1 of 1"
    assert scores["tip_mm"]["value"] < 0.5
    write_benchmark(result, tmp_path / "out", "sonoservo benchmark mine")
    written = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert written["scores"]["mine"][ALL] == scores
    table = (tmp_path / "out" / "benchmark.md").read_text()
    assert "| found | 1 of 1 |" in table
    assert "| 0.75 to 0.95 | 100 % (" in table
    assert kept_markdown(result.outcomes) == table.replace("salt 9", "salt 0")
    assert "clean, seed 9000: cut along" in (tmp_path / "out" / "report.html").read_text()
    with pytest.raises(ConfigurationError, match=r"no table of a sequence, such as clean"):
        resolve_entrant(str(tmp_path), {"clean_seed9000": None})


def test_made_volumes_are_read_with_their_truth_and_checksums(short, sequence, tmp_path):
    options = BenchmarkOptions(folder=tmp_path, suites=["clean"], quick=True, salt=9, jobs=1)
    (outcome,) = make_volumes(options)
    assert outcome, outcome.error
    for line in (tmp_path / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split()
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
    recording = Recording(tmp_path / "clean_seed9000.seq.nrrd")
    zea = Recording(tmp_path / "clean_seed9000.hdf5")
    assert len(recording) == len(zea) == len(sequence.volumes)
    np.testing.assert_array_equal(recording[9].intensities, sequence.volumes[9].intensities)
    pose = sequence.volumes[9].X_WP.GetAsMatrix4()
    np.testing.assert_array_equal(recording[9].X_WP.GetAsMatrix4(), pose)
    np.testing.assert_allclose(zea[9].X_WP.GetAsMatrix4(), pose, atol=1e-6)
    needle = read_truth(tmp_path / "clean_seed9000.truth.jsonl").needles[-1]
    np.testing.assert_allclose(needle.tip, sequence.truth.needle_tip[-1])
    assert "CC BY 4.0" in (tmp_path / "README.md").read_text()


def test_the_command_refuses_what_does_not_go_together():
    assert "takes no trackers" in sonoservo_here("benchmark", "make", "chatelain2013").stderr
    assert "unknown suite" in sonoservo_here("benchmark", "--suite", "cleen").stderr
