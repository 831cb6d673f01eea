"""Calibration of a recording's poses, and tracking with corrected ones."""

import json

import numpy as np
import pytest
from commands import sonoservo_here
from pydrake.math import RigidTransform
from recordings import write_sequence_nrrd
from still_tissue import LyingProbe

from sonoservo.diagrams import MakeNeedleTracker, TrackerBench, track_recording
from sonoservo.diagrams.tracker_bench import Sample
from sonoservo.systems.recording import Recording

LYING = LyingProbe(delay=0.06, X_PI=RigidTransform([1e-3, 0.0, 1e-3]))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibrated") / "a.seq.nrrd"
    LYING.record(path, 11)
    return path


def test_a_recording_is_calibrated(recorded, tmp_path):
    done = sonoservo_here("calibrate", str(recorded), "--json", str(tmp_path / "a.json"))
    assert done.returncode == 0, done.stderr
    assert "delay, ms" in done.stdout
    figures = json.loads((tmp_path / "a.json").read_text())
    assert figures["delay_ms"] == pytest.approx(60, abs=6)
    assert figures["delay_std_ms"] < 6
    assert figures["pairs"] >= 8


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    path = tmp_path_factory.mktemp("short") / "a.seq.nrrd"
    LYING.record(path, 3)
    return path


def test_a_short_recording_is_not_calibrated(short):
    done = sonoservo_here("calibrate", str(short))
    assert done.returncode == 1
    assert "too few" in done.stdout


def test_a_recording_without_poses_is_refused(tmp_path):
    arrays = [np.full((9, 8, 7), k, np.uint8) for k in range(3)]
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", arrays)
    done = sonoservo_here("calibrate", str(path))
    assert done.returncode == 2
    assert "have no poses to be calibrated" in done.stderr


def test_tracking_corrects_and_reports_the_errors(recorded, short, tmp_path):
    result = track_recording(Recording(recorded), correct_poses=True, out=tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["pose_errors"]["delay_ms"] == pytest.approx(60, abs=6)
    assert len(result.estimates) == 11
    assert "pose_errors" not in track_recording(Recording(short)).summary


def test_a_place_in_the_image_stays_there_when_poses_are_corrected(recorded):
    X_WL, frames = RigidTransform([0.1, 0.2, 0.3]), []
    bench = TrackerBench(MakeNeedleTracker(period=1.0, correct_poses=True))
    samples = (Sample(volume, X_WL) for volume in Recording(recorded))
    assert bench.run(samples, [lambda tracked: frames.append((tracked.volume, tracked.X_WL))])
    assert len(bench.log().compute["track"]) == len(frames) == 11
    (volume, X), corrected = frames[-1], bench.evaluate("corrected_volume")
    p_P = np.array([5e-3, 40e-3, 2e-3])
    moved = np.linalg.norm(corrected.X_WP.multiply(p_P) - volume.X_WP.multiply(p_P))
    assert moved > 0.5e-3
    np.testing.assert_allclose(
        X.inverse().multiply(corrected.X_WP.multiply(p_P)),
        X_WL.inverse().multiply(volume.X_WP.multiply(p_P)),
        atol=1e-12,
    )
