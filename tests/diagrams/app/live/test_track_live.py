"""Volumes over sockets: tracked, recorded, played and served, against the same in files."""

import csv
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from live_items import FakeOutlet, wait_until
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Gain
from still_tissue import LyingProbe
from synthetic_volumes import Scene, entry_on_side

from sonoservo.diagrams import MakeNeedleTracker, load_scenario, run, track_recording
from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.diagrams.app.live.bridge import play_live, record_live
from sonoservo.diagrams.app.live.serve import live_senders, needle_names
from sonoservo.diagrams.app.live.track_live import live_volumes, track_live
from sonoservo.diagrams.app.options import LiveLimits
from sonoservo.diagrams.app.volumes.track import tracker_parameters
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live.connection.address import parse_address
from sonoservo.systems.live.connection.items import ImageItem, StatusItem
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.feeds import needle_feed, volume_items
from sonoservo.systems.live.image_matcher import ImageMatcher
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.live.motor_sweep import MotorSweepParameters, MotorSweepVolumes
from sonoservo.systems.live.sender import Sender
from sonoservo.systems.live.volume_receiver import VolumeReceiver
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.recording.side_files import ACQUISITION, side_path
from sonoservo.systems.signals.immutable import NotFound

COUNT = 10
ENTRY = entry_on_side()
K = np.array([1, 0.25, 0.1]) / np.linalg.norm([1, 0.25, 0.1])
COMMAND = [sys.executable, "-m", "sonoservo.diagrams.app"]


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


@pytest.mark.slow
def test_poses_are_corrected_live_as_in_the_recording(tmp_path):
    lying = LyingProbe(delay=0.06, X_PI=RigidTransform([1e-3, 0.0, 1e-3]))
    recording = lying.record(tmp_path / "a.seq.nrrd", 10)
    expected = track_recording(recording, correct_poses=True).summary["pose_errors"]
    with played(recording) as source:
        summary = track_live(source, limits=LiveLimits(volumes=10), correct_poses=True)
    assert summary["pose_errors"] == expected
    assert expected["delay_ms"] > 0


def test_stream_of_another_scanner_is_tracked_as_the_bridge_records_it(recording, tmp_path):
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
    estimates = []
    with scanner(play) as source:
        track_live(
            source,
            parameters=anywhere(),
            limits=limits,
            after_volume=lambda number, estimate: estimates.append(estimate),
        )
    expected = track_recording(recorded, parameters=anywhere()).estimates
    assert [each.mode for each in estimates] == [each.mode for each in expected]
    assert sum(map(bool, estimates)) >= COUNT - 4  # three looks, half a second apart
    for here, there in zip(estimates, expected, strict=True):
        if here:
            points = here.curve.control_points, there.curve.control_points
            np.testing.assert_array_equal(*points)


def test_bridge_records_what_was_played(recording, tmp_path):
    path = tmp_path / "copy.seq.nrrd"
    with played(recording) as source:
        summary = record_live(source, path, limits=LiveLimits(volumes=COUNT))
    assert summary["volumes"] == COUNT
    assert path.read_bytes() == recording.path.read_bytes()
    there, here = (side_path(each, ACQUISITION).read_text() for each in (recording.path, path))
    assert here == there


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
        "Acquisition",
        "Image_Probe",
        "Frame",
        "SliceA_Probe",
        "SliceB_Probe",
        "ProbeToReference",
        "NeedleStatus",
        "TrueTissueToRef",
    }
    assert max(len(name) for name in names) <= 20


def test_frames_of_a_run_are_its_volumes(served):
    scenario, items = served
    parameters = MotorSweepParameters(
        probe=scenario.probe,
        imaging=scenario.imaging,
        scan_conversion=scenario.scan_conversion,
    )
    frames = ImageMatcher(device="Frame", poses="ProbeToReference", layers=False, report=quiet)
    maker = MotorSweepVolumes(parameters)
    volumes = [
        volume for item in items for posed in frames.feed(item, 0.0) if (volume := maker(posed))
    ]
    images = [item for item in items if isinstance(item, ImageItem) and item.name == "Image_Probe"]
    assert len(volumes) == len(images) >= 2
    for volume, image in zip(volumes, images, strict=True):
        np.testing.assert_array_equal(volume.intensities, image.voxels)
        assert volume.time == image.time


def test_observers_have_no_outputs():
    scenario = load_scenario("chatelain2013_fig4")
    with pytest.raises(ConfigurationError, match=r"observers\.gain: '1 outputs' is not allowed"):
        run(scenario, observers={"gain": Gain(1.0, 1)})


def test_receiver_tracker_and_sender_are_a_diagram(recording):
    """Volumes come in at a simulator's steps, and estimates go out."""

    class Source:
        def __init__(self):
            self.volumes = [recording[k] for k in range(4)]

        def take(self, timeout=0.0):
            return self.volumes.pop(0) if self.volumes else NotFound("nothing")

    outlet, source = FakeOutlet(), Source()
    builder = DiagramBuilder()
    receiver = builder.AddSystem(VolumeReceiver(source=source))
    tracker = builder.AddSystem(MakeNeedleTracker(parameters=anywhere(), period=0.1, offset=0.05))
    sender = builder.AddSystem(Sender(outlet=outlet, feed=needle_feed(), period=0.1, offset=0.09))
    builder.Connect(receiver.GetOutputPort("volume"), tracker.GetInputPort("volume"))
    builder.Connect(tracker.GetOutputPort("estimate"), sender.GetInputPort("estimate"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    assert not source.volumes
    assert outlet.sent[-1][1][0].time == pytest.approx(recording.times[3])


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
        (["bridge", "igtl://a", "igtl://b"], "one must be an address (igtl://...)"),
        (["track", "igtl://a:99999"], "is no address"),
        (["track", "udp://a"], "unknown protocol 'udp'"),
        (
            ["run", "carriere2016_d60", "--no-meshcat", "--serve", "igtl://:0"],
            "one of 'following' is needed here",
        ),
        (["track", "nowhere.seq.nrrd", "--show"], "nowhere.seq.nrrd"),
        (
            [
                "run",
                "chatelain2013_fig5",
                "--serve",
                "igtl://:0",
                "--wait-for",
                "1",
                "--record",
                "volumes.txt",
            ],
            "volumes.txt",
        ),
    ],
)
def test_mistakes_are_one_line(arguments, message, capsys):
    assert run_arguments(arguments) == 2
    printed = capsys.readouterr()
    (line,) = printed.err.splitlines()
    assert message in line
    assert "http://" not in printed.out  # no page is announced that shows nothing


@pytest.mark.slow
def test_interruption_ends_at_once_and_leaves_what_is_valid(recording, tmp_path):
    with Link(parse_address("igtl://:0"), report=quiet) as server:
        command = ["track", f"igtl://localhost:{server.port}", "--out", str(tmp_path)]
        with subprocess.Popen([*COMMAND, *command], stdout=subprocess.PIPE, text=True) as tracking:
            try:
                wait_until(lambda: server.peers, 60)
                play_live(recording, server, speed=0)
                table = tmp_path / "estimates.csv"
                wait_until(lambda: table.is_file() and len(rows_of(tmp_path)) >= 2, 120)
                tracking.send_signal(signal.SIGINT)
                printed, _ = tracking.communicate(timeout=60)
            finally:
                tracking.kill()  # or a failure would wait for it, and it for more volumes
    assert tracking.returncode == 0
    assert "from the last byte to the estimate sent" in " ".join(printed.split())
    assert all(None not in row.values() for row in rows_of(tmp_path))
    assert (tmp_path / "summary.json").is_file()
