"""A tracker of one's own in `run` and `track`, in the forms that the benchmark takes."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from live_items import make_volume
from pydrake.common.value import Value

from sonoservo.diagrams import run, track_recording
from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.diagrams.app.own_tracker import as_system
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording
from sonoservo.systems.recording.side_files import TRUTH, side_path
from sonoservo.systems.signals import TrackingMode

SHORT = ["duration=0.9", "imaging.frames=7", "imaging.volume_rate=8", "hand.start=0.2"]
MINE = """
from dataclasses import replace

import numpy as np
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

def make():
    seen = []
    def track(volume):
        seen.append(volume)
        ends = volume.X_WP.multiply(np.array([[0.0, 0.03, 0.0], [0.001 * len(seen), 0.04, 0.0]]).T)
        return NeedleEstimate(
            TrackingMode.TRACKING, volume.time, curve=NeedleCurve(ends.T),
            velocity=np.zeros((2, 3)), covariance=1e-6 * np.eye(12), volume_time=volume.time,
        )
    return track

def wrong():
    return lambda volume: 5

def failing():
    return lambda volume: 1 / 0

def aside():
    def track(volume):
        estimate = make()(volume)
        return replace(estimate, curve=NeedleCurve(estimate.curve.control_points + 0.3))
    return track

def failing_later():
    track, left = make(), [2, 1]
    return lambda volume: track(volume) if left and left.pop() else 1 / 0

def bare():
    def track(volume):
        curve = NeedleCurve(np.array([[0.0, 0.03, 0.0], [0.01, 0.04, 0.0]]))
        return NeedleEstimate(TrackingMode.TRACKING, volume.time, curve=curve)
    return track

def millimetres():
    def track(volume):
        estimate = make()(volume)
        return replace(estimate, curve=NeedleCurve(1e3 * estimate.curve.control_points))
    return track

def doubtless():
    return lambda volume: replace(make()(volume), covariance=-np.eye(12))

def ahead():
    return lambda volume: replace(make()(volume), time=volume.time + 100)

def timeless():
    return lambda volume: NeedleEstimate(TrackingMode.SEARCHING, volume.time)

def interrupted():
    def track(volume):
        raise KeyboardInterrupt
    return track

def ending():
    raise SystemExit(4)

def plain(volume):
    return 5
"""


def looked(system):
    """Show a volume to a tracker's system."""
    context = system.CreateDefaultContext()
    system.GetInputPort("volume").FixValue(context, Value[object](make_volume(1.0)))
    system.ExecuteForcedEvents(context)


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_tracker_of_a_test.py").write_text(MINE)
    monkeypatch.syspath_prepend(str(tmp_path))
    import own_tracker_of_a_test

    return own_tracker_of_a_test


def test_a_function_runs_and_tracks_alike_whether_given_itself_or_by_its_factory(
    mine, tmp_path, capsys
):
    path = tmp_path / "a.seq.nrrd"
    result = run("chatelain2013_fig5", changes=SHORT, tracker=mine.make(), record=path)
    tips = result.log.volume_estimate_tip
    assert len(tips) == len(Recording(path)) > 3
    assert np.isfinite(tips).all()
    again = track_recording(Recording(path), tracker=mine.make())
    np.testing.assert_array_equal([each.curve.tip for each in again.estimates], tips)
    factory = "own_tracker_of_a_test:make"
    command = ["track", str(path), "--tracker", "./own_tracker_of_a_test.py:make"]
    assert run_arguments([*command, "--out", "judged"]) == 0
    assert "No needle was found, and something else was taken for it" in " ".join(
        capsys.readouterr().out.split()
    )  # says the truth beside the recording
    side_path(path, TRUTH).unlink()
    assert run_arguments([*command, "--json", "t.json", "--out", "t"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"A needle was found at {again.times[0]:.2f} s and tracked in {len(tips)} of" in said
    assert f"of {len(tips)} volumes; its tip was last at (" in said
    assert run_arguments(["track", str(path), "--out", "none"]) == 0
    assert "No needle was found. Volumes without a needle:" in " ".join(
        capsys.readouterr().out.split()
    )
    assert json.loads((tmp_path / "t.json").read_text())["modes"] == {"tracking": len(tips)}
    changes = [each for change in (*SHORT, f"tracker={factory}") for each in ("--set", change)]
    command = ["run", "chatelain2013_fig5", *changes, "--no-meshcat", "--json", "r.json"]
    assert run_arguments([*command, "--out", "r"]) in (0, 3)
    told = json.loads((tmp_path / "r.json").read_text())
    assert told["tracking"] == result.summary["tracking"]


def test_volumes_count_if_the_estimates_do_not_name_them(mine):
    log = run("chatelain2013_fig5", changes=SHORT, tracker="own_tracker_of_a_test:timeless").log
    assert len(log.volume_time) > 3


def test_what_was_tracked_before_a_failure_is_kept(mine, tmp_path):
    path = tmp_path / "a.seq.nrrd"
    run("chatelain2013_fig5", changes=SHORT, tracker=mine.make(), record=path)
    side_path(path, TRUTH).unlink()
    result = track_recording(Recording(path), tracker=mine.failing_later(), out=tmp_path / "t")
    assert len((tmp_path / "t" / "estimates.csv").read_text().splitlines()) == 3
    assert not result.found.endswith("outside what the volumes show.")
    away = track_recording(Recording(path), tracker=mine.aside())
    assert away.found.endswith("outside what the volumes show.")
    failure = str(result.failure)
    for part in ("failed at", "own_tracker_of_a_test.py, line", "ZeroDivisionError: division by"):
        assert part in failure


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        ("wrong", "expected a NeedleEstimate"),
        ("bare", "needs its velocity and covariance"),
        ("millimetres", "m from the probe; .* are in W, in m"),
        ("doubtless", "covariance has negative variances"),
        ("ahead", "100 s ahead of its volume"),
        ("failing", "tracker of yours failed.*division by zero"),
        ("plain", "plain: it is called without arguments"),
        ("ending", "ending: it is called without arguments.*: SystemExit: 4"),
    ],
)
def test_what_is_no_tracker_is_refused(mine, factory, message):
    with pytest.raises(ConfigurationError, match=message):
        run("chatelain2013_fig5", changes=SHORT, tracker=f"own_tracker_of_a_test:{factory}")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"time": np.nan}, "time: nan is not allowed"),
        ({"time": None}, "time: None is not allowed"),
        ({"probability": np.nan}, "probability: nan is not allowed"),
        ({"probability": None}, "probability: None is not allowed"),
        ({"probability": 7.0}, r"probability: 7\.0 is not allowed.*from 0 to 1"),
        ({"mode": "found"}, "mode: 'found'; one of searching, tracking"),
        ({"mode": TrackingMode.SEARCHING}, "mode: searching, with a curve"),
        ({"curve": None, "velocity": None, "covariance": None}, "mode: tracking, without a curve"),
    ],
)
def test_an_estimate_that_makes_no_sense_is_refused_at_once(mine, changed, message):
    with pytest.raises(ConfigurationError, match=f"make.*: {message}"):
        looked(as_system(lambda volume: replace(mine.make()(volume), **changed), period=0.1))


def test_a_tracker_that_ends_the_program_has_failed(mine):
    with pytest.raises(ConfigurationError, match="failed at 1.00 s.*SystemExit: 3"):
        looked(as_system(lambda volume: sys.exit(3), period=0.1))
    with pytest.raises(KeyboardInterrupt):
        looked(as_system(mine.interrupted(), period=0.1))


def test_a_tracker_out_of_place_is_refused(mine, capsys):
    with pytest.raises(ConfigurationError, match="tracker: a value of type int"):
        run("chatelain2013_fig5", changes=SHORT, tracker=5)
    with pytest.raises(ConfigurationError, match="tracker: not possible in the experiment"):
        run("carriere2016_d60", tracker=mine.make())
    assert run_arguments(["track", "a.nrrd", "--tracker", "mine:make", "--seed", "1"]) == 2
    assert "made without arguments" in capsys.readouterr().err
    assert run_arguments(["track", "a.nrrd", "--tracker", "mine"]) == 2
    assert "module:factory names one of your own" in capsys.readouterr().err
