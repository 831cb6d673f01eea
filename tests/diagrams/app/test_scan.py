import json

import nrrd
import numpy as np
import pytest
import yaml
from commands import sonoservo_here
from PIL import Image
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.diagrams import load_scenario, scan
from sonoservo.diagrams.app.scan import summarize_scan
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.ultrasound.simulation.anatomy.anatomies import LIVER_LABELS, liver_label_map
from sonoservo.systems.ultrasound.simulation.anatomy.label_map import write_label_map

SCENARIO = "chatelain2013_fig5"


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(SCENARIO, changes=["hand.dip_deg=0", "hand.angle_spread_deg=0"])


@pytest.fixture(scope="module")
def shown(scenario):
    return scan(scenario)


def test_the_probe_is_pressed_on_the_phantom_over_the_deepest_needle(scenario, shown):
    assert shown.needle.length == pytest.approx(0.097, abs=0.5e-3)
    (tip,) = shown.volume.to_probe(shown.needle.tip[np.newaxis])
    np.testing.assert_allclose(tip[[0, 2]], 0, atol=1e-9)
    top = shown.volume.to_probe(scenario.station.X_WT.translation()[np.newaxis])[0, 1]
    assert top == pytest.approx(-4e-3)
    along = shown.volume.X_WP.rotation().matrix().T @ shown.needle.curve.direction
    assert abs(np.rad2deg(np.arctan2(along[2], along[0]))) == pytest.approx(40, abs=0.1)


def test_without_a_needle_the_probe_is_where_the_scenario_starts(scenario):
    empty = scan(scenario, time=0.0)
    assert not empty.needle
    start = scenario.station.probe_pose(height=-4e-3)
    np.testing.assert_allclose(empty.volume.X_WP.GetAsMatrix4(), start.GetAsMatrix4(), atol=1e-12)
    assert summarize_scan(empty, scenario)["inserted_mm"] == 0


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_needle_beside_the_sector_is_left_out(scenario):
    away = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0.09, 0.05, -0.004])
    beside = scan(scenario, time=6.0, X_TP=away)
    assert beside.needle
    figure = beside.plot()
    assert not any(axes.texts for axes in figure.axes)


def test_the_sheet_reads_in_millimetres_and_decibels(shown):
    figure = shown.plot()
    frame, along, across, elevation, bar = figure.axes
    left, right, bottom, top = frame.images[0].get_extent()
    assert bottom == pytest.approx(90, abs=0.5)
    assert top < 0
    assert right == pytest.approx(130 * np.sin(np.deg2rad(0.608768 * 47.5)), abs=0.5)
    assert left == pytest.approx(-right, abs=0.5)
    assert [text.get_text() for text in along.texts] == ["tip"]
    np.testing.assert_allclose(along.texts[0].xy, [0, 38], atol=5)
    assert bar.get_ylabel() == "echo amplitude, dB"
    assert [label.get_text() for label in bar.get_yticklabels()][:2] == ["0", "-10"]
    assert across.get_ylabel() == "across it, mm"
    assert elevation.get_xlabel() == "elevation, mm"


def test_command_writes_picture_volume_and_figures(tmp_path):
    probe = tmp_path / "mine.yaml"
    probe.write_text("transducer: {array_radius: 0.040}\n")
    result = sonoservo_here("scan", "--out", str(tmp_path / "new"), "--seed", "2",
                       "--json", str(tmp_path / "scan.json"),
                       "--set", f"probe={probe}")  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "leaves out what is taken from the 4DC7-3/40: motor_radius, lines" in result.stdout
    assert "27 frames x 96 lines x 293 samples" in result.stdout
    with Image.open(tmp_path / "new" / "scan.png") as picture:
        assert min(picture.size) > 800
    data, header = nrrd.read(str(tmp_path / "new" / "scan.nrrd"))
    figures = json.loads((tmp_path / "scan.json").read_text())
    assert figures["seed"] == 2
    assert figures["inserted_mm"] > 50  # of fig. 5, when the needle is deepest
    assert list(data.shape) == figures["voxels"]
    np.testing.assert_allclose(np.diag(header["space directions"]), figures["spacing_mm"])


def test_a_mistake_is_refused():
    with pytest.raises(ConfigurationError, match="phantom: there is no 'agr'; did you mean 'agar'"):
        scan(SCENARIO, changes=["phantom=agr"])
    with pytest.raises(ConfigurationError, match="time: -5.0 is not allowed"):
        scan(SCENARIO, time=-5.0)


def test_a_moving_probe_s_sweep_can_be_compensated():
    """A needle across the frames leans over, by what the probe moved, and does not with it."""
    changes = [
        "hand.entry=[0, -0.06, -0.04]", "hand.azimuth_deg=90", "hand.dip_deg=0",
        "hand.entry_spread=[0, 0, 0]", "hand.angle_spread_deg=0", "station.probe.yaw_deg=0",
    ]  # fmt: skip
    pose = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0, 0, -0.004])
    slopes = {}
    for compensate in (False, True):
        flag = f"scan_conversion.compensate_motion={str(compensate).lower()}"
        moving = load_scenario(SCENARIO, changes=[*changes, flag])
        shown = scan(moving, X_TP=pose, velocity=[0.02, 0, 0])
        volume = shown.volume
        places = np.argwhere(volume.intensities > 150)
        x, y, z = volume.position(places).T
        keep = (np.abs(x) < 6e-3) & (np.abs(z) < 0.02) & (np.abs(y - 0.036) < 4e-3)
        slopes[compensate] = np.polyfit(z[keep], x[keep], 1)[0]
    # 20 mm/s for 303 ms, while the sweep goes over 43 mm of elevation at that depth.
    assert slopes[False] == pytest.approx(-0.142, abs=0.03)
    assert slopes[True] == pytest.approx(0, abs=0.02)


def test_a_label_map_is_scanned_by_itself(tmp_path):
    labels = liver_label_map(2)
    write_label_map(tmp_path / "mine.nrrd", labels)
    table = [vars(each) for each in LIVER_LABELS]
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"tissue": {"anatomy": {"labels": table}}}))
    out = tmp_path / "out"
    result = sonoservo_here("scan", "--phantom", str(tmp_path / "mine.nrrd"), "--out", str(out))
    assert result.returncode == 0, result.stderr
    assert (out / "scan.png").stat().st_size > 50_000
    (tmp_path / "mine.yaml").write_text("tissue: {anatomy: {labels: []}}")
    result = sonoservo_here("scan", "--phantom", str(tmp_path / "mine.nrrd"), "--out", str(out))
    assert result.returncode == 2
    assert "[1, 2, 3, 4, 5]" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_needle_that_misses_the_phantom_is_refused():
    with pytest.raises(ConfigurationError, match=r"hand\.entry: \[-120"):
        scan("chatelain2013_fig5", changes=["hand.entry=[-120, 0, -42]"])
