"""Volumes over sockets: tracked, recorded, played and served, against the same in files."""

import csv
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from live_items import FakeOutlet, wait_until
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.primitives import Gain
from synthetic_volumes import ENTRY, K, Scene

from sonoservo.diagrams import load_scenario, run, track_recording, tracker_parameters
from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.diagrams.app.live.bridge import play_live, record_live
from sonoservo.diagrams.app.live.serve import live_senders, needle_names
from sonoservo.diagrams.app.live.track_live import live_volumes, track_live
from sonoservo.diagrams.app.options import LiveLimits
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live import Link, LiveSource, parse_address
from sonoservo.systems.live.connection.items import StatusItem
from sonoservo.systems.live.feeds import volume_items
from sonoservo.systems.recording import Recording, RecordingWriter
from sonoservo.systems.recording.side_files import ACQUISITION, side_path

COUNT = 10


def needle(time):
    return ENTRY, ENTRY + (0.015 + 4e-3 * time) * K


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A needle that is pushed in, seen from a probe that moves."""
    path = tmp_path_factory.mktemp("played") / "a.seq.nrrd"
    scene = Scene(seed=5, spacing=1.2e-3)
    with RecordingWriter(path, {"tracker_seed": 101}) as writer:
        for number in range(1, COUNT + 1):
            X_WP = RigidTransform(RollPitchYaw(0, 0, 0.01 * number), [5e-4 * number, 0, 0])
            writer.append(scene.volume(number, needle, X_WP))
    return Recording(path)


def anywhere():
    return tracker_parameters(start="anywhere")


@pytest.fixture(scope="module")
def expected(recording):
    return track_recording(recording, parameters=anywhere())


def quiet(line):
    """Say nothing."""


@contextmanager
def scanner(play, keep=COUNT):
    """A source of what a function sends, on a thread, once the connection is there."""
    with Link(parse_address("igtl://:0"), report=quiet) as server:

        def start():
            wait_until(lambda: server.peers)
            play(server)

        thread = threading.Thread(target=start)
        thread.start()
        address = parse_address(f"igtl://localhost:{server.port}")
        with LiveSource(address, keep=keep, report=quiet) as source:
            yield source
        thread.join()


def played(recording):
    """A source of recorded volumes."""
    return scanner(lambda link: play_live(recording, link, speed=0), keep=len(recording))


def rows_of(folder):
    with (folder / "estimates.csv").open() as file:
        return list(csv.DictReader(file))


def test_live_estimates_are_those_of_the_recording_to_the_last_bit(recording, expected, tmp_path):
    outlet = FakeOutlet()
    with played(recording) as source:
        summary = track_live(
            source,
            parameters=anywhere(),
            outlets=[outlet],
            out=tmp_path,
            limits=LiveLimits(volumes=COUNT),
        )
    rows = rows_of(tmp_path)
    assert summary["modes"].get("tracking", 0) >= COUNT - 4  # three looks, half a second apart
    assert len(rows) == COUNT
    for row, other in zip(rows, expected.rows, strict=True):
        for name, value in other.items():
            shown = "" if isinstance(value, float) and value != value else str(value)
            assert row[name] == shown, name
    assert summary["latency_ms"]["besides_tracking"]["p99"] > 0
    assert (tmp_path / "summary.json").is_file()
    # What was sent is the same, with the time of the volume it belongs to.
    status, tip, *_ = outlet.sent[-1][1]
    assert isinstance(status, StatusItem)
    assert tip.time == pytest.approx(recording.times[-1], abs=1e-9)
    np.testing.assert_array_equal(tip.X.translation(), expected.estimates[-1].curve.tip)


def test_bridge_records_the_stream_of_another_scanner(recording, tmp_path):
    """It tells grid and pose as float32, and not when each frame was acquired."""
    volumes = [recording[k] for k in range(COUNT)]

    def play(link):
        for volume in volumes:
            link.send(volume_items(volume)[1:], topic="volume", keep=COUNT)

    limits = LiveLimits(volumes=COUNT)
    with scanner(play) as source:
        record_live(source, tmp_path / "b.seq.nrrd", limits=limits)
    recorded = Recording(tmp_path / "b.seq.nrrd")
    for here, there in zip(recorded, volumes, strict=True):
        np.testing.assert_array_equal(here.intensities, there.intensities)
        np.testing.assert_allclose(here.origin, there.origin, atol=1e-8)
        np.testing.assert_allclose(here.spacing, there.spacing, atol=1e-9)
        assert here.X_WP.IsNearlyEqualTo(there.X_WP, 1e-6)
        assert here.time == pytest.approx(there.time, abs=1e-9)


def test_bridge_records_what_was_played(recording, tmp_path):
    path = tmp_path / "copy.seq.nrrd"
    with played(recording) as source:
        summary = record_live(source, path, limits=LiveLimits(volumes=COUNT))
    assert summary["volumes"] == COUNT
    assert path.read_bytes() == recording.path.read_bytes()
    there, here = (side_path(each, ACQUISITION).read_text() for each in (recording.path, path))
    assert here == there
    with pytest.raises(ConfigurationError, match="another name"):
        record_live(source, path)
    assert path.read_bytes() == recording.path.read_bytes()


def test_an_interruption_keeps_what_was_tracked(recording, tmp_path):
    def stop(number, estimate):
        if number == 1:
            raise KeyboardInterrupt

    with played(recording) as source:
        track_live(source, out=tmp_path, after_volume=stop)
    assert len(rows_of(tmp_path)) >= 1
    assert (tmp_path / "summary.json").is_file()


def test_quiet_stream_ends_by_patience(tmp_path, capsys):
    said = []
    with Link(parse_address("igtl://:0"), report=quiet) as server:
        address = parse_address(f"igtl://localhost:{server.port}")
        with LiveSource(address, report=quiet) as source:
            assert list(live_volumes(source, LiveLimits(patience=0.3), said.append)) == []
        copy = tmp_path / "copy.seq.nrrd"
        for command in (
            ["bridge", str(address), str(copy)],
            ["track", str(address), "--out", str(tmp_path)],
        ):
            assert run_arguments([*command, "--patience", "0.3"]) == 1
        assert str(copy) not in capsys.readouterr().out
    assert "for 0.3 s: ending" in said[-1]
    for limits in ({"patience": float("nan")}, {"patience": -1.0}, {"volumes": 0}):
        with pytest.raises(ValueError, match="is not allowed; it must be a number above 0"):
            LiveLimits(**limits)


@pytest.fixture(scope="module")
def served():
    """Everything that a short run sends, and its volumes."""
    scenario = load_scenario("chatelain2013_fig4", seed=103, changes=["duration=0.6"])
    outlet = FakeOutlet()
    run(scenario, observers=live_senders(outlet, scenario))
    return scenario, [item for _, items in outlet.sent for item in items]


def test_run_sends_all_that_it_makes_under_names_that_fit(served):
    _, items = served
    names = {item.name for item in items}
    assert names == {
        "Acquisition", "Image_Probe", "Frame", "SliceA_Probe", "SliceB_Probe", "ProbeToReference",
        "NeedleStatus", "TrueTissueToRef",
    }  # fmt: skip
    assert max(len(name) for name in names) <= 20


def test_observers_have_no_outputs():
    scenario = load_scenario("chatelain2013_fig4")
    with pytest.raises(ConfigurationError, match=r"observers\.gain: '1 outputs' is not allowed"):
        run(scenario, observers={"gain": Gain(1.0, 1)})


def test_names_of_devices_can_be_set():
    names = needle_names(["tip=Tip", "status="], points=True)
    assert (names.tip, names.status, names.points) == ("Tip", "", True)
    with pytest.raises(ConfigurationError, match="name: 'tap=x'; .*tip"):
        needle_names(["tap=x"])
    with pytest.raises(ConfigurationError, match="at most 20 bytes"):
        needle_names(["tip=" + 21 * "x"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bridge", "a.seq.nrrd", "b.seq.nrrd"], "one must be an address (igtl://...)"),
        (["track", "nowhere.seq.nrrd", "--show"], "nowhere.seq.nrrd"),
        (["run", "chatelain2013_fig5", "--serve", "igtl://:0", "--record", "v.txt"], "v.txt"),
    ],
)
def test_mistakes_are_one_line(arguments, message, capsys):
    assert run_arguments(arguments) == 2
    printed = capsys.readouterr()
    (line,) = printed.err.splitlines()
    assert message in line
    assert "http://" not in printed.out  # no page is announced that shows nothing
