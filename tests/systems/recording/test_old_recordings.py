"""Recordings written before the volumes told their scale are read as they were then."""

import json

import numpy as np
import pytest

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.recording import Recording

HEADER = """NRRD0005
# Written by sonoservo
type: uint8
dimension: 4
sizes: 5 4 3 2
space: left-posterior-superior
space directions: (0.7,0.0,0.0) (0.0,0.7,0.0) (0.0,0.0,0.7) none
space origin: (-1.4,3.0,-0.7)
space units: "mm" "mm" "mm"
kinds: domain domain domain list
labels: "" "" "" "time"
units: "" "" "" "s"
endian: little
encoding: raw
DataNodeClassName:=vtkMRMLScalarVolumeNode
axis 3 index type:=numeric
axis 3 index values:=0.145 0.448
Seq_Frame0000_ProbeToReferenceTransform:=1.0 0.0 0.0 454.0 0.0 1.0 0.0 0.1 0.0 0.0 1.0 208.5 0 0 0 1.0
Seq_Frame0000_ProbeToReferenceTransformStatus:=OK
Seq_Frame0000_Timestamp:=0.145
Seq_Frame0001_ProbeToReferenceTransform:=1.0 0.0 0.0 455.0 0.0 1.0 0.0 0.1 0.0 0.0 1.0 208.5 0 0 0 1.0
Seq_Frame0001_ProbeToReferenceTransformStatus:=OK
Seq_Frame0001_Timestamp:=0.448

"""  # noqa: E501
VOXELS = np.random.default_rng(0).integers(0, 256, (2, 5, 4, 3)).astype(np.uint8)
FIRST = {
    "format": 1,
    "origin": [-0.0014, 0.003, -0.0007],
    "spacing": [0.0007, 0.0007, 0.0007],
    "geometry": {
        "array_radius": 0.04,
        "motor_radius": 0.02725,
        "line_pitch": 0.01062500598078084,
        "frame_pitch": 0.025534166956677044,
        "sample_pitch": 0.000308,
        "lines": 4,
        "frames": 3,
        "samples": 20,
        "frame_period": 0.1,
        "sound_speed": 1540.0,
    },
    "dynamic_range_db": 50.0,
    "tracker_seed": 3371720702,
}


def posed(x):
    X_WP = np.eye(4)
    X_WP[:3, 3] = x, 0.0001, 0.2085
    return X_WP.tolist()


@pytest.fixture
def old(tmp_path):
    """Make an old recording, with or without what lay beside it."""

    def make(first=FIRST):
        path = tmp_path / "old.seq.nrrd"
        data = b"".join(volume.tobytes(order="F") for volume in VOXELS)
        path.write_bytes(HEADER.encode() + data)
        if first is not None:
            lines = [first] + [
                {
                    "time": time,
                    "X_WP": posed(x),
                    "direction": direction,
                    "frame_times": [time - 0.1, time, time + 0.1][::direction],
                    "frame_X_WP": [posed(x)] * 3,
                }
                for time, x, direction in ((0.145, 0.454, 1), (0.448, 0.455, -1))
            ]
            text = "".join(json.dumps(line) + "\n" for line in lines)
            path.with_name("old.acquisition.jsonl").write_text(text)
        return path

    return make


def test_the_same_numbers_and_the_noted_range(old):
    recording = Recording(old())
    assert recording.settings == {"tracker_seed": 3371720702}
    for k, volume in enumerate(recording):
        np.testing.assert_array_equal(volume.intensities, VOXELS[k])
        np.testing.assert_array_equal(volume.origin, FIRST["origin"])
        np.testing.assert_array_equal(volume.spacing, FIRST["spacing"])
        assert volume.time == (0.145, 0.448)[k]
        assert volume.motion.direction == (1, -1)[k]
        assert volume.motion.geometry.samples == 20
        assert volume.decibels_per_level == 50 / 255
        assert volume.point_spread is None
    assert Recording(old(), dynamic_range_db=72.0)[0].decibels_per_level == 72 / 255


@pytest.mark.parametrize("first", [None, {k: FIRST[k] for k in FIRST if k != "dynamic_range_db"}])
def test_who_noted_no_range_has_60_decibels_or_what_is_given(old, first):
    path = old(first)
    assert Recording(path)[1].decibels_per_level == 60 / 255
    assert Recording(path, dynamic_range_db=40.0)[1].decibels_per_level == 40 / 255


def test_an_impossible_range_is_one_line(old):
    path = old(None)
    with pytest.raises(ConfigurationError, match=r"old\.seq\.nrrd: dynamic_range_db: -1"):
        Recording(path, dynamic_range_db=-1.0)
    text = path.read_bytes()
    path.write_bytes(text.replace(b"# Written", b"decibels_per_level:=loud\n# Written"))
    with pytest.raises(ConfigurationError, match="loud"):
        Recording(path)
