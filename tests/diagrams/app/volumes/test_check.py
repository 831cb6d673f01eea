"""`sonoservo check` on files and streams, and its gravest finding in other commands."""

import json
import threading

import nibabel
import numpy as np
import pytest
from live_items import make_volume, wait_until
from openigtlink import free_port
from pydrake.math import RigidTransform
from recordings import write_sequence_nrrd
from still_tissue import LyingProbe
from tracked_frames import freehand, write_plus_file

from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.diagrams.app.options import Reading
from sonoservo.diagrams.app.volumes.check import check_file, check_stream
from sonoservo.systems.evaluation.source_checks import Check, Grade
from sonoservo.systems.live import Link, parse_address
from sonoservo.systems.live.connection.items import ImageItem, PoseItem
from sonoservo.systems.recording import Recording, write_volume


def found(checked, check):
    return [each for each in checked.findings if each.check is check]


def test_late_poses_are_told_with_their_interval(tmp_path):
    late = LyingProbe(delay=0.08).record(tmp_path / "a.seq.nrrd", 14)
    (finding,) = found(check_file(late.path), Check.DELAY)
    assert finding.grade is Grade.DOUBTFUL
    low, high = (
        float(finding.text.split("95 %: ")[1].split(")")[0].split(" to ")[k]) for k in (0, 1)
    )
    assert low < 80 < high
    assert high - low < 40
    assert "--correct-poses" in finding.advice


def test_a_recording_of_a_probe_held_still_needs_nothing_and_each_volume_is_read_once(
    tmp_path, monkeypatch
):
    held = LyingProbe(path=lambda _: RigidTransform()).record(tmp_path / "a.seq.nrrd", 8)
    numbers, read = [], Recording.__getitem__
    monkeypatch.setattr(
        Recording, "__getitem__", lambda self, k: numbers.append(k) or read(self, k)
    )
    wrong = [each for each in check_file(held.path).findings if each.grade]
    assert {each.check for each in wrong} <= {Check.SPACING}  # its voxels of 1 mm
    assert numbers == list(range(8))


@pytest.mark.parametrize("count", [3, 20])
def test_volumes_of_nan_are_told(tmp_path, count):
    nothing = count * [np.full((20, 30, 20), np.nan, np.float32)]
    found = check_file(write_sequence_nrrd(tmp_path / "a.seq.nrrd", nothing)).gravest
    assert found.grade is Grade.WRONG
    assert "stand" in found.text


def test_what_needs_no_times_is_told_without_them(tmp_path):
    levels = np.random.default_rng(0).integers(1, 256, (20, 30, 20, 4), dtype=np.uint8)
    nibabel.save(nibabel.Nifti1Image(levels, np.eye(4)), tmp_path / "a.nii")
    checked = check_file(tmp_path / "a.nii")
    assert "20 x 30 x 20 voxels" in found(checked, Check.KIND)[0].text
    (finding,) = found(checked, Check.RATE)
    assert (finding.grade, "--volume-rate" in finding.text) == (Grade.WRONG, True)


def noise(count):
    levels = np.random.default_rng(0).integers(1, 256, (count, 20, 30, 20), dtype=np.uint8)
    return list(levels)


def test_volumes_left_out_are_told_by_their_reason(tmp_path):
    times = 0.6 * np.arange(12) - 3 * (np.arange(12) > 5)
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", noise(12), times=times.tolist())
    checked = check_file(path)
    (finding,) = found(checked, Check.LEFT_OUT)
    assert finding.text == "5 volumes whose time breaks the order"
    assert finding.advice == "look at the clock"
    assert "runs back (by up to 2.4 s) 1 x" in found(checked, Check.CLOCK)[0].text
    assert len(found(checked, Check.RATE)) == 1
    assert not found(check_file(path, Reading(volume_rate=2.0)), Check.CLOCK)


@pytest.mark.parametrize(
    ("fields", "given", "text"),
    [
        ({}, None, "60 dB by assumption"),
        ({"decibels_per_level": "0.2"}, None, "51 dB, as stated with"),
        ({"decibels_per_level": "0.2"}, 50.0, "50 dB, as --dynamic-range-db says"),
    ],
)
def test_range_from_black_to_white_is_told(tmp_path, fields, given, text):
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", noise(2), **fields)
    checked = check_file(path, Reading(dynamic_range_db=given))
    assert any(f"black to white is {text}" in each.text for each in found(checked, Check.LEVELS))


def test_a_step_of_one_second_is_doubted_unless_given(tmp_path):
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", noise(3), times=[0.0, 1.0, 2.0])
    asked = [bool(found(check_file(path, each), Check.RATE)[-1].grade) for each in (
        Reading(), Reading(volume_rate=1.0)
    )]  # fmt: skip
    assert asked == [True, False]


def test_times_do_not_matter_to_a_single_volume(tmp_path, capsys):
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", noise(3), times=[5.0, 2.0, 1.0])
    assert run_arguments(["locate", str(path), "--number", "2"]) == 1  # no needle
    out = "".join(capsys.readouterr())
    assert "a second" not in out
    assert "left out" not in out


def test_frames_are_told_by_their_kind_chain_and_sweeps(tmp_path, capsys):
    path = write_plus_file(tmp_path / "f.igs.mha", freehand(30, turns=2, dtype=np.uint8))
    checked = check_file(path)
    assert "90 2D frames of 40 x 50 pixels" in found(checked, Check.KIND)[0].text
    assert "0.5 x 0.4 mm" in found(checked, Check.MATRIX)[0].text
    assert "20 frames a second" in found(checked, Check.RATE)[0].text
    assert checked.picture is not None
    json_path, out = tmp_path / "c.json", tmp_path / "out"
    code = run_arguments(["check", str(path), "--out", str(out), "--json", str(json_path)])
    told = json.loads(json_path.read_text())
    assert code == int(told["needs_something"])
    assert (out / "orientation.png").is_file()
    assert "matrices" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        (b"ImageToReferenceTransform =", b"Nothing =", "no poses"),
        (b"DimSize = 40 50 30", b"DimSize = 40 50 900000", "truncated"),
    ],
)
def test_file_that_cannot_be_read_is_a_finding(tmp_path, capsys, before, after, text):
    path = write_plus_file(tmp_path / "f.mha", freehand(30, dtype=np.uint8))
    path.write_bytes(path.read_bytes().replace(before, after))
    (finding,) = check_file(path).findings
    assert (finding.check, finding.grade) == (Check.READING, Grade.WRONG)
    assert text in finding.text
    assert run_arguments(["check", str(path)]) == 1
    assert "what to do" not in capsys.readouterr().out
    assert run_arguments(["check", str(tmp_path / "nowhere.mha")]) == 2


def test_a_compressed_file_that_was_cut_short_is_told(tmp_path):
    path, rng = tmp_path / "a.nii.gz", np.random.default_rng(0)
    voxels = rng.integers(0, 255, (20, 20, 10, 9), np.uint8).repeat(2, axis=2)
    series = nibabel.Nifti1Image(voxels, np.eye(4))
    series.header.set_xyzt_units("mm", "sec")
    series.header["pixdim"][4] = 0.3
    nibabel.save(series, path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    found = check_file(path).gravest
    assert (found.check, found.grade) == (Check.READING, Grade.WRONG)
    assert "cannot be read" in found.text


@pytest.mark.parametrize(
    ("error", "shear", "orientation", "needed"),
    [
        ("0.4", "0", 'PortUsImageOrientation="MF"', ""),
        ("3.4", "0", 'PortUsImageOrientation="MF"', "3.4"),
        ("0.4", "0.1", 'PortUsImageOrientation="MF"', "angle"),
        ("0.4", "0", "", "orientation"),
    ],
)
def test_configuration_of_plus(tmp_path, error, shear, orientation, needed):
    path = tmp_path / "c.xml"
    path.write_text(
        f"""<PlusConfiguration version="2.3"><DataCollection><Device Id="V" {orientation}/>
        </DataCollection><CoordinateDefinitions><Transform From="Image" To="Probe" Error="{error}"
        Date="2026" Matrix="0.2 {shear} 0 1  0 0.2 0 2  0 0 0.2 3  0 0 0 1"/>
        </CoordinateDefinitions></PlusConfiguration>"""
    )
    checked = check_file(path)
    assert any("ImageToProbe" in each.text for each in found(checked, Check.MATRIX))
    assert (checked.gravest is None) == (needed == "")
    assert needed in str(checked.gravest or "")
    path.write_text("<x/>")
    assert check_file(path).gravest.check is Check.READING


def test_other_commands_say_the_gravest_finding_in_one_line(tmp_path, capsys):
    volume = make_volume(shape=(20, 20, 20))
    one = type(volume)(volume.intensities, [0, 0, 0], [1e-3] * 3, RigidTransform(), 1.0)
    path = write_volume(tmp_path / "one.nrrd", one)
    assert run_arguments(["locate", str(path)]) == 1  # no needle
    (line,) = [each for each in capsys.readouterr().out.splitlines() if "sonoservo check" in each]
    assert "spacing: 1 x 1 x 1 mm" in line


def test_messages_name_options_of_the_command_that_was_called(tmp_path, capsys):
    path = write_plus_file(tmp_path / "f.igs.mha", freehand(30, dtype=np.uint8))
    for command, advice in (
        ("track", "volumes of them with --reconstruct"),
        ("calibrate", "volumes of them with `sonoservo track --reconstruct`"),
    ):
        assert run_arguments([command, str(path)]) == 2
        assert advice in capsys.readouterr().err


@pytest.fixture
def stream():
    """A server, and a function that makes it send what one returns for each number."""
    with Link(parse_address("igtl://:0"), report=lambda line: None) as server:

        def start(make, count=8, pause=0.1):
            def send():
                wait_until(lambda: server.peers)
                for number in range(count):
                    server.send(make(number), topic=f"{number}")
                    threading.Event().wait(pause)

            threading.Thread(target=send, daemon=True).start()
            return parse_address(f"igtl://localhost:{server.port}")

        yield start


def image(time):
    voxels = make_volume(shape=(20, 20, 20)).intensities
    return ImageItem("Image_Probe", time, voxels, np.diag([8e-4, 7e-4, 9e-4, 1.0]))


def pose(number, name="ProbeToReference", apart=0.0):
    X = RigidTransform([1e-3 * number, 0, 0])
    return PoseItem(name, 1000 + 0.1 * number + apart, X)


def listened(address, **options):
    return check_stream(address, seconds=1.2, say=lambda line: None, **options)


def test_stream_is_told_by_its_devices_and_rates(stream):
    checked = listened(stream(lambda k: [pose(k), image(1000 + 0.1 * k)]))
    assert "Image_Probe (image), ProbeToReference (pose)" in found(checked, Check.KIND)[0].text
    assert any("10 messages of Image_Probe" in each.text for each in found(checked, Check.RATE))
    assert "0.8 x 0.7 x 0.9 mm" in found(checked, Check.SPACING)[0].text
    assert not found(checked, Check.CLOCK)


def test_clocks_that_are_apart_and_other_transforms_need_something(stream):
    checked = listened(stream(lambda k: [pose(k, apart=-500), image(1000 + 0.1 * k)]))
    (finding,) = found(checked, Check.CLOCK)
    assert "behind" in finding.text
    assert float(finding.advice.rpartition(" ")[2].strip(")")) == pytest.approx(-500, abs=0.2)


def test_stream_without_the_expected_transform_names_the_others(stream):
    checked = listened(stream(lambda k: [pose(k, "StylusToTracker"), image(0.0)]))
    assert "StylusToTracker" in found(checked, Check.CHAIN)[0].text
    assert "stand still" in found(checked, Check.CLOCK)[0].text


def test_silent_stream_is_wrong(stream):
    address = stream(lambda k: [], count=0)
    (finding,) = listened(address, patience=0.3).findings
    assert finding.grade is Grade.WRONG


def test_how_long_it_waits_for_a_stream_and_that_nobody_answers_is_said_at_once():
    said = []
    check_stream(parse_address(f"igtl://localhost:{free_port()}"), patience=0.3, say=said.append)
    assert said[0].endswith("for 5 s; the first message may take 0.3 s")
    assert said[1].endswith("no connection (ECONNREFUSED); trying again; Ctrl-C ends")
