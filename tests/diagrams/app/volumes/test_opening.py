"""Tracked 2D frames, as PLUS records them, from the file to the needle."""

import json

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from synthetic_volumes import ENTRY, K, Scene
from tracked_frames import freehand, write_plus_file

from sonoservo.diagrams import track_recording, tracker_parameters
from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.diagrams.app.volumes.opening import ReconstructedRecording
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame

TIP = ENTRY + 0.03 * K
X_WP = RigidTransform(RollPitchYaw(0.3, -0.2, 0.5), [0.1, 0.2, 0.3])


def sweeps_over_a_needle(path, count):
    """Frames cut from a volume with a needle, at any pose."""
    volume = Scene(seed=5, spacing=0.9e-3).volume(4, lambda time: (ENTRY, TIP))
    frames = []
    for sweep in range(count):
        layers = range(volume.intensities.shape[2])
        for k in layers if sweep % 2 == 0 else reversed(layers):
            X_PI = np.eye(4)
            X_PI[:3, :3] = np.diag(volume.spacing)
            X_PI[:3, 3] = volume.position([0, 0, k])
            time = 10 + 0.02 * len(frames)
            pixels = volume.intensities[:, :, k]
            frames.append(PosedFrame(pixels, X_WP.GetAsMatrix4() @ X_PI, time))
    return write_plus_file(path, frames)


def test_freehand_sweeps_are_tracked_where_the_needle_is(tmp_path):
    path = sweeps_over_a_needle(tmp_path / "freehand.igs.mha", 3)
    opened = ReconstructedRecording(path, spacing=0.9e-3)
    assert len(opened) == 3
    assert (np.diff(opened.times) > 0).all()
    result = track_recording(opened, parameters=tracker_parameters(start="anywhere"))
    found = result.estimates[-1]
    assert found
    assert np.linalg.norm(found.curve.tip - X_WP.multiply(TIP)) < 1.5e-3
    row = result.rows[-1]
    np.testing.assert_allclose(
        [row["tip_l_mm"], row["tip_p_mm"], row["tip_s_mm"]], 1e3 * found.curve.tip, atol=1e-9
    )


def test_a_needle_is_located_in_a_single_sweep(tmp_path, capsys):
    path = sweeps_over_a_needle(tmp_path / "freehand.igs.mha", 1)
    arguments = ["locate", str(path), "--reconstruct", "--spacing", "0.9", "--json", "-"]
    assert run_arguments(arguments) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["frame"] == "the frame of the poses"
    assert np.linalg.norm(1e-3 * np.array(found["tip_mm"]) - X_WP.multiply(TIP)) < 1.5e-3
    for said in ("single sweep", "Poses: Image to Reference", "guide wire"):
        assert said in printed.err


def test_volumes_of_a_fixed_number_of_frames(tmp_path):
    path = write_plus_file(tmp_path / "f.igs.mha", freehand(25, dtype=np.uint8))
    opened = ReconstructedRecording(path, frames=10)
    assert len(opened) == 3
    assert [len(volume.frame_times) for volume in opened] == [10, 10, 5]
    assert opened[-1].time == opened.times[-1]
    with pytest.raises(ConfigurationError, match="frames"):
        ReconstructedRecording(path, frames=1)


def test_probe_at_rest_makes_no_volume(tmp_path):
    still = freehand(1, dtype=np.uint8)[0]
    frames = [PosedFrame(still.pixels, still.X_WI, 1.0 + k) for k in range(4)]
    path = write_plus_file(tmp_path / "f.mha", frames)
    with pytest.raises(ConfigurationError, match="moves over 0 mm, too little for a volume"):
        ReconstructedRecording(path)
