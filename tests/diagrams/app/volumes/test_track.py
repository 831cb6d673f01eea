"""Trackers on recordings: ours, to the last bit, and those that other software wrote."""

import csv
import json
import resource
import time

import nrrd
import numpy as np
import pytest
from recordings import tracked, write_meta_image, write_sequence_nrrd
from synthetic_volumes import ENTRY, K, Scene

from sonoservo.diagrams import load_scenario, run, track, track_recording, tracker_parameters
from sonoservo.diagrams.benchmark.estimates import OPTIONAL, REQUIRED
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording, RecordingWriter
from sonoservo.systems.ultrasound import ScanConversion, make_grid


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A short run as in fig. 4, and its recording."""
    path = tmp_path_factory.mktemp("recorded") / "a.seq.nrrd"
    changes = ["duration=5.5", "hand.start=0.5", "hand.pushes.0.speed=0.012"]
    scenario = load_scenario("chatelain2013_fig4", seed=101, changes=changes)
    return path, run(scenario, record=path, record_sweeps=True)


def test_a_recording_gives_the_estimates_of_the_live_run_exactly(live, tmp_path):
    path, result = live
    recording = Recording(path)
    seen = track_recording(recording, out=tmp_path)
    assert path.stat().st_size / len(recording) == pytest.approx(1.5e6, rel=0.05)  # as documented
    assert result.summary["tracking"]["tracked"] > 10
    columns = [n for n in vars(type(result.log))["__dataclass_fields__"] if n.startswith("volume_")]
    assert len(columns) > 10
    # Only the scanner knows the motion of a sweep, as measured and in truth.
    unknown = {"volume_X_WP", "volume_true_time", "volume_true_X_WP"}
    assert all(np.isnan(getattr(seen.log, name)).all() for name in unknown)
    for name in set(columns) - unknown - {"volume_seen"}:
        there, here = getattr(result.log, name), getattr(seen.log, name)
        np.testing.assert_array_equal(here, there, err_msg=name)
    for block in ("detection", "tracking"):
        for name, figure in result.summary[block].items():
            if name.endswith(("_mm", "_deg")) and name != "absent_travel_mm":
                near = 2e-3 if name == "tip_error_in_probe_mm" else 1e-9  # it has the motion
                assert seen.summary[block][name] == pytest.approx(figure, rel=near), name
    true = seen.log.visible_length[np.searchsorted(seen.log.time, seen.times[-1])]
    assert seen.in_view[-1] == pytest.approx(true, abs=2e-3)

    names = "estimates.csv estimates.json summary.json log.npz planes.png tip.png errors.png"
    assert {each.name for each in tmp_path.iterdir()} == {*names.split(), "report.html"}
    with (tmp_path / "estimates.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(json.loads((tmp_path / "estimates.json").read_text()))
    assert rows[0]["tip_l_mm"] == ""
    assert float(rows[-1]["probability"]) == seen.estimates[-1].probability
    assert set(REQUIRED) | set(OPTIONAL) - {"process_ms"} <= rows[0].keys()
    last = np.array([float(rows[-1][f"tip_{axis}_mm"]) for axis in "lps"])
    volume = Recording(path)[len(rows) - 1]
    # LPS are the axes of the probe in a file of ours.
    np.testing.assert_allclose(last, 1e3 * volume.to_probe([seen.estimates[-1].curve.tip])[0])
    names = [f"tip_covariance_{axes}_mm2" for axes in ("ll", "lp", "ls", "pp", "ps", "ss")]
    assert rows[0][names[0]] == ""
    stated = np.zeros((3, 3))
    stated[np.triu_indices(3)] = [float(rows[-1][name]) for name in names]
    R_PW = volume.X_WP.rotation().matrix().T
    expected = 1e6 * R_PW @ seen.estimates[-1].tip_covariance @ R_PW.T
    np.testing.assert_allclose(stated, np.triu(expected), atol=1e-9)
    assert seen.verdict.headline == result.verdict.headline  # the truth is beside the recording
    assert "tip error, median, mm" in str(seen)
    assert "tip error, median, mm" in seen._repr_html_()
    assert seen.plot().axes[0].get_ylabel() == "mm"


def test_an_interrupted_run_leaves_a_recording(tmp_path):
    def stop(experiment):
        if experiment.time > 0.7:
            raise KeyboardInterrupt

    path = tmp_path / "a.seq.nrrd"
    result = run(load_scenario("chatelain2013_fig4", seed=101), record=path, after_step=stop)
    assert result.summary["interrupted"]
    assert [volume.time for volume in Recording(path)] == list(result.log.volume_time[:3])
    assert {each.name for each in tmp_path.iterdir()} == {
        "a.seq.nrrd",
        "a.acquisition.jsonl",
        "a.truth.jsonl",
    }


def test_sweeps_are_recorded_as_acquired(live):
    path, _ = live
    data, header = nrrd.read(str(path.with_name("a.sweeps.seq.nrrd")))
    recording = Recording(path)
    motion = recording[21].motion
    assert data.shape == (*motion.geometry.shape[::-1], len(recording))
    assert header["Seq_Frame0021_SweepDirection"] == str(motion.direction) == "-1"
    # Scan conversion of what was recorded gives the volume that was recorded.
    conversion = ScanConversion(motion.geometry, make_grid(motion.geometry, 0.7e-3))
    volume = conversion.convert(np.ascontiguousarray(data[..., 21].T), motion.direction)
    np.testing.assert_array_equal(volume, recording[21].intensities)


SCENE = Scene(seed=5, spacing=1.2e-3)
STEPS = (1.2, 1.2, 1.2)


def needle(time):
    length = min(5e-3 * (time - 2), 0.03)
    return (ENTRY, ENTRY + length * K) if length > 0 else None


@pytest.fixture(scope="module")
def volumes():
    return [SCENE.volume(k, needle) for k in range(30, 36)]


@pytest.fixture
def path(tmp_path, volumes):
    with RecordingWriter(tmp_path / "a.seq.nrrd") as writer:
        for volume in volumes:
            writer.append(volume)
    return tmp_path / "a.seq.nrrd"


def test_anywhere_finds_a_needle_that_was_always_there(path):
    assert not any(track_recording(Recording(path)).estimates)
    anywhere = tracker_parameters(start="anywhere")
    found = track_recording(Recording(path), parameters=anywhere).estimates
    # Three looks, one in each volume.
    assert [bool(each) for each in found] == [False, False, True, True, True, True]
    assert np.linalg.norm(found[-1].curve.tip - needle(99)[1]) < 2e-3
    # Without the motion of the sweep, as in others' files, it is found as well.
    path.with_name("a.acquisition.jsonl").unlink()
    found = track_recording(Recording(path), parameters=anywhere).estimates
    assert np.linalg.norm(found[-1].curve.tip - needle(99)[1]) < 2e-3
    empty = [SCENE.volume(k) for k in range(3)]
    assert not any(track(empty, parameters=anywhere))


def test_poses_of_plus_carry_the_needle_into_the_tracker_s_frame(tmp_path, volumes):
    array = volumes[-1].intensities
    path = write_meta_image(tmp_path / "a.mha", [array] * 3, tracked(3, [1]), steps=STEPS)
    at_once = tracker_parameters(start="anywhere")
    at_once.track.volumes_to_follow = 1
    result = track_recording(Recording(path), parameters=at_once, out=tmp_path / "out")
    assert result.summary["skipped"] == 1
    (first, second) = result.rows
    for row, moved in ((first, 0), (second, 4)):
        # As `tracked` turns and moves the file's coordinates; the filter averages in the world.
        assert row["world_tip_x_mm"] == pytest.approx(-row["tip_p_mm"] + moved, abs=1e-9)
        assert row["world_tip_y_mm"] == pytest.approx(row["tip_l_mm"] + 5, abs=1e-9)


def test_real_time_goes_no_faster(tmp_path):
    path = write_sequence_nrrd(
        tmp_path / "a.seq.nrrd", [np.ones((8, 9, 10), np.uint8)] * 4, times=[0, 0.1, 0.2, 0.4]
    )
    track_recording(Recording(path))
    begin = time.perf_counter()
    track_recording(Recording(path), real_time=True)
    assert time.perf_counter() - begin >= 0.4


def test_an_interruption_keeps_what_was_tracked(path, tmp_path):
    def stop(number, estimate):
        if number == 0:
            raise KeyboardInterrupt

    result = track_recording(Recording(path), out=tmp_path / "out", after_volume=stop)
    assert result.summary["interrupted"]
    assert "sonoservo locate" in result.summary["advice"]
    assert len(result.rows) == 1
    assert (tmp_path / "out" / "report.html").is_file()


def test_what_cannot_be_carried_out_is_refused_before_anything_is_written(tmp_path):
    path = write_sequence_nrrd(
        tmp_path / "a.seq.nrrd", [np.ones((8, 9, 10), np.uint8)] * 2, times=[0, 0.1]
    )
    with pytest.raises(ConfigurationError, match="--correct-poses: no poses are used"):
        track_recording(Recording(path), correct_poses=True)
    with pytest.raises(ConfigurationError, match="--out: .* results need another folder"):
        track_recording(Recording(path), out=path)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"tracker": "zhao2021"}, "did you mean 'zhao2012'"),
        ({"order": 5}, "order: 5 is not allowed"),
        ({"order": 3, "tracker": "zhao2012"}, "order: 3"),
        ({"start": "nowhere"}, "start: 'nowhere'"),
    ],
)
def test_choices_are_checked(choice, message):
    with pytest.raises(ConfigurationError, match=message):
        tracker_parameters(**choice)


@pytest.mark.slow
def test_a_thousand_volumes_leave_the_memory_flat(tmp_path):
    """200 MB of volumes; what is held grows by the estimates only."""
    shape = (60, 60, 56)
    noise = np.random.default_rng(0).integers(1, 90, shape).astype(np.uint8)
    path = tmp_path / "long.seq.nrrd"
    header = (
        "NRRD0004\ntype: uint8\ndimension: 4\nspace: LPS\nsizes: 60 60 56 1000\n"
        "space directions: (1,0,0) (0,1,0) (0,0,1) none\nkinds: domain domain domain list\n"
        'labels: "" "" "" "time"\nencoding: raw\n'
        f"axis 3 index values:={' '.join(str(0.2 * k) for k in range(1000))}\n\n"
    )
    with path.open("wb") as file:
        file.write(header.encode())
        for k in range(1000):
            file.write(np.roll(noise, k % 7, axis=0).tobytes())
    used = {}

    def note(number, estimate):
        used[number] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    track_recording(Recording(path), after_volume=note)
    assert used[999] - used[100] < 15e3  # kB


def test_what_a_user_knows_about_the_probe_and_the_needle_is_taken():
    localizer = tracker_parameters(beam_width=1.5e-3, echo_offset=0.2e-3).localizer
    assert localizer.tip.beam_width == 1.5e-3
    assert (localizer.echo_offset, localizer.echo_offset_std) == (0.2e-3, 0.0)
    with pytest.raises(ConfigurationError, match="beam_width"):
        tracker_parameters(beam_width=0.0)
