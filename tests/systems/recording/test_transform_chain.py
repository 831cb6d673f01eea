"""Names of transforms have directions; calibrations and configurations complete the chain."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from recordings import write_meta_image
from tracked_frames import freehand, write_plus_file

from sonoservo.diagrams.app.options import ReadingFrames
from sonoservo.diagrams.app.volumes.opening import open_volumes
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording
from sonoservo.systems.recording.plus_configuration import read_calibration, read_plus_configuration
from sonoservo.systems.recording.tracked_frames import TrackedFrames
from sonoservo.systems.recording.transform_chain import find_chain

HERE = Path("a.mha")


def pose(k, *angles):
    X = RigidTransform(RollPitchYaw(*angles), [10.0 * k, 5, -3]).GetAsMatrix4()
    return X


MATRICES = {
    "ImageToProbe": pose(1, 0.1, 0.2, 0.3) @ np.diag([0.3, 0.4, 0.5, 1]),
    "ProbeToTracker": pose(2, -0.3, 0.1, 0.5),
    "ReferenceToTracker": pose(3, 0.2, -0.4, 0.1),
}
IMAGE_TO_REFERENCE = (
    np.linalg.inv(MATRICES["ReferenceToTracker"])
    @ MATRICES["ProbeToTracker"]
    @ MATRICES["ImageToProbe"]
)


def text(matrix):
    return " ".join(map(repr, np.asarray(matrix).ravel().tolist()))


@pytest.mark.parametrize(
    ("names", "poses", "chain"),
    [
        ("ImageToReference", None, "Image to Reference: ImageToReference"),
        (
            "ImageToProbe ProbeToTracker ReferenceToTracker StylusToTracker",
            None,
            "Image to Reference: ImageToProbe, ProbeToTracker, inverse of ReferenceToTracker",
        ),
        ("ReferenceToProbe", None, "Probe to Reference: inverse of ReferenceToProbe"),
        (
            "ImageToProbe ProbeToTracker ProbeToReference",
            "ImageToTracker",
            "Image to Tracker: ImageToProbe, ProbeToTracker",
        ),
        (
            "ProbeToTracker ReferenceToTracker",
            "ProbeToTracker, TrackerToReference",
            "Probe to Reference: ProbeToTracker, inverse of ReferenceToTracker",
        ),
    ],
)
def test_the_chain_is_found_by_the_names(names, poses, chain):
    assert str(find_chain(HERE, names.split(), poses)) == chain


@pytest.mark.parametrize(
    ("names", "poses", "message"),
    [
        ("StylusToReference", None, "StylusToReference.* none of them is that of the image or"),
        ("ImageToProbe", None, "a transform from Probe to Reference or another frame"),
        ("ProbeToTracker", "ProbeToWorld", "no transform 'ProbeToWorld', nor a chain"),
        ("ProbeToTracker ImageToProbe", "ProbeToTracker,ImageToProbe", "does not go on from Trac"),
    ],
)
def test_what_is_missing_is_said(names, poses, message):
    with pytest.raises(ConfigurationError, match=message):
        find_chain(HERE, names.split(), poses)
    assert find_chain(HERE, names.split(), "none") is None


def test_the_chain_is_the_product(tmp_path):
    fields = {f"Seq_Frame0000_{name}Transform": text(X) for name, X in MATRICES.items()}
    array = np.arange(1, 61, dtype=np.uint8).reshape(5, 4, 3)
    path = write_meta_image(tmp_path / "a.mha", [array], fields, steps=(1, 1, 1))
    recording = Recording(path)
    (volume,) = recording
    # The transform tells the size of a voxel, whatever the header says.
    np.testing.assert_allclose(sorted(volume.spacing), [3e-4, 4e-4, 5e-4])
    at = np.unravel_index(volume.intensities.argmax(), volume.intensities.shape)
    place = 1e3 * volume.to_world(volume.position([at]))[0][0]
    np.testing.assert_allclose(place, (IMAGE_TO_REFERENCE @ [4, 3, 2, 1])[:3], atol=1e-6)
    assert "inverse of ReferenceToTracker" in " ".join(recording.notes)


CONFIGURATION = """<PlusConfiguration version="2.9">
  <DataCollection>
    <DeviceSet Name="a set" Description="of devices" />
    <Device Id="VideoDevice" Type="Epiphan" LocalTimeOffsetSec="-0.25">
      <DataSources>
        <DataSource Type="Video" Id="Video" PortUsImageOrientation="UF" />
      </DataSources>
    </Device>
    <Device Id="TrackerDevice" Type="PolarisTracker" LocalTimeOffsetSec="0.05">
      <DataSources><DataSource Type="Tool" Id="Probe" PortName="0" /></DataSources>
    </Device>
  </DataCollection>
  <VolumeReconstruction ClipRectangleOrigin="4 3" ClipRectangleSize="30 40" />
  <CoordinateDefinitions>
    <Transform From="Image" To="Probe" Error="0.7" Date="2024-03-01"
      Matrix="MATRIX" />
  </CoordinateDefinitions>
</PlusConfiguration>"""


@pytest.fixture
def tracked(tmp_path):
    """Frames with the pose of the probe alone, their calibration, and what they should be."""
    frames = freehand(6, dtype=np.uint8)
    metres = np.diag([1e3, 1e3, 1e3, 1.0])
    calibration = pose(1, 0.1, 0.2, 0.3) @ np.diag([0.5, 0.4, 1, 1])
    moved = [
        type(frame)(frame.pixels, np.linalg.inv(metres) @ (metres @ frame.X_WI @
                    np.linalg.inv(calibration)), frame.time) for frame in frames
    ]  # fmt: skip
    path = write_plus_file(tmp_path / "f.igs.mha", moved, name="ProbeToReference")
    return path, calibration, frames


def test_a_calibration_is_refused_if_missing_and_taken_from_anywhere(tmp_path, tracked):
    path, calibration, frames = tracked
    with pytest.raises(ConfigurationError, match=r"calibration ImageToProbe is missing.*--plus-c"):
        TrackedFrames(path)
    with pytest.raises(ConfigurationError, match="ImageToProb: unknown; did you .*'ImageToProbe'"):
        TrackedFrames(path, transforms={"ImageToProb": calibration})
    (tmp_path / "c.txt").write_text("\n".join(text(row) for row in calibration))
    rows = np.concatenate([np.diag([0.5, 0.4, 1, 1]), pose(1, 0.1, 0.2, 0.3)])
    np.savetxt(tmp_path / "calib_matrix.csv", rows, delimiter=",", fmt="%.17g")
    for given in (text(calibration), tmp_path / "c.txt", tmp_path / "calib_matrix.csv"):
        name, matrix = read_calibration(str(given))
        np.testing.assert_allclose(matrix, calibration)
        read = TrackedFrames(path, transforms={name: matrix})
        np.testing.assert_allclose(read.X_WI[2], frames[2].X_WI, atol=1e-9)
    once = tmp_path / "once.igs.mha"  # in the header, for all frames
    line = f"ImageToProbeTransform = {text(calibration)}\nElementSpacing = 0.3 0.3 1\n"
    once.write_bytes(path.read_bytes().replace(b"ElementType", line.encode() + b"ElementType", 1))
    np.testing.assert_allclose(TrackedFrames(once).X_WI[2], frames[2].X_WI, atol=1e-9)
    once.write_bytes(
        once.read_bytes().replace(
            b"ElementSp", b"ImageToProbeTransformStatus = INVALID\nElementSp", 1
        )
    )
    with pytest.raises(ConfigurationError, match=r"invalid: ImageToProbeTransformStatus is not OK"):
        TrackedFrames(once)
    assert read_calibration(f"ProbeToTracker={text(np.eye(4))}")[0] == "ProbeToTracker"
    with pytest.raises(ConfigurationError, match="no file 'missing.txt'"):
        read_calibration("missing.txt")
    with pytest.raises(ConfigurationError, match="3 numbers; expected 16"):
        read_calibration("1 0 0")


def test_a_configuration_of_plus_completes_a_file(tmp_path, tracked):
    path, calibration, frames = tracked
    config = tmp_path / "config.xml"
    config.write_text(CONFIGURATION.replace("MATRIX", text(calibration)))
    known = read_plus_configuration(config)
    assert (known.orientation, round(known.time_offset, 6)) == ("UF", -0.3)
    opened = open_volumes(path, ReadingFrames(reconstruct=True, plus_config=config))
    shift = np.eye(4)
    shift[:2, 3] = 4, 3
    np.testing.assert_allclose(opened._frames.X_WI[3], frames[3].X_WI @ shift, atol=1e-9)
    notes = " ".join(opened.notes)
    for said in ("ImageToProbe, error 0.7 mm, of 2024-03-01", "UF", "-0.3 s", "ProbeToReference"):
        assert said in notes
    # The file states its own orientation; one that does not has that of the configuration.
    np.testing.assert_array_equal(opened._frames[0], frames[0].pixels[4:34, 3:43])
    path.write_bytes(path.read_bytes().replace(b"UltrasoundImageOrientation = MF\n", b""))
    turned = open_volumes(path, ReadingFrames(reconstruct=True, plus_config=config))
    np.testing.assert_array_equal(turned._frames[0], frames[0].pixels[::-1][4:34, 3:43])
    path.write_bytes(path.read_bytes().replace(b"NDims", b"UltrasoundImageOrientation = XX\nNDims"))
    assert "is XX: read as MF" in " ".join(
        TrackedFrames(path, transforms={"ImageToProbe": calibration}).notes
    )
    turned = open_volumes(path, ReadingFrames(reconstruct=True, plus_config=config))
    np.testing.assert_array_equal(turned._frames[0], frames[0].pixels[::-1][4:34, 3:43])
    config.write_text(config.read_text().replace('"30 40"', '"300 40"'))
    with pytest.raises(ConfigurationError, match="reaches beyond the frames of 40 x 50"):
        open_volumes(path, ReadingFrames(reconstruct=True, plus_config=config))


@pytest.mark.parametrize(
    "content", ["<x/>", "text", '<!DOCTYPE a [<!ENTITY b "c">]><PlusConfiguration/>']
)
def test_other_xml_is_no_configuration(tmp_path, content):
    (tmp_path / "a.xml").write_text(content)
    with pytest.raises(ConfigurationError, match=r"no configuration of PLUS|not XML"):
        read_plus_configuration(tmp_path / "a.xml")
