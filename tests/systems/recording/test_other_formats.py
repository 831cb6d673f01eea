"""Formats that laboratories have: HDF5 of TUS-REC and zea, DICOM, and PNG with a table of poses."""

import copy
import csv
import sys

import h5py
import nibabel
import nrrd
import numpy as np
import pydicom
import pytest
from PIL import Image
from pydicom.dataset import FileMetaDataset
from pydicom.uid import (
    EnhancedUSVolumeStorage,
    ExplicitVRLittleEndian,
    UltrasoundMultiFrameImageStorage,
    generate_uid,
)
from pydrake.math import RigidTransform, RollPitchYaw
from synthetic_volumes import Scene
from tracked_frames import freehand

from sonoservo.diagrams.app.options import Reading
from sonoservo.diagrams.app.volumes.check import check_file
from sonoservo.diagrams.app.volumes.opening import open_volumes
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording
from sonoservo.systems.recording.grey_levels import as_frame
from sonoservo.systems.recording.pose_table import read_pose_table
from sonoservo.systems.recording.tracked_frames import TrackedFrames
from sonoservo.systems.recording.zea import ZeaWriter

PIXEL = np.diag([0.5, 0.4, 1, 1])
CALIBRATION = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [10, 5, -3]).GetAsMatrix4() @ PIXEL


@pytest.fixture(scope="module")
def frames():
    return freehand(8, dtype=np.uint8)


def sensor_poses(frames):
    """The poses of the sensor on the probe, in mm."""
    mm = np.diag([1e3, 1e3, 1e3, 1.0])
    return [mm @ frame.X_WI @ np.linalg.inv(CALIBRATION) for frame in frames]


def assert_same_frames(read, frames, shift=0.0):
    assert len(read) == len(frames)
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(read[number], frame.pixels)
        np.testing.assert_allclose(read.X_WI[number], frame.X_WI, atol=1e-7)
    np.testing.assert_allclose(read.times - read.times[0], 0.05 * np.arange(len(frames)))


@pytest.mark.parametrize("apart", [False, True])
def test_scans_of_tus_rec(tmp_path, frames, apart):
    folder = tmp_path / "frames" / "050" if apart else tmp_path / "050"
    folder.mkdir(parents=True)
    path = folder / "RH_rotation.h5"
    poses = np.array(sensor_poses(frames))
    with h5py.File(path, "w") as file:
        file["frames"] = np.array([frame.pixels.T for frame in frames])
        if not apart:
            file["tforms"] = poses
    if apart:
        with pytest.raises(ConfigurationError, match="no transforms"):
            TrackedFrames(path)
        (tmp_path / "transfs" / "050").mkdir(parents=True)
        with h5py.File(tmp_path / "transfs" / "050" / path.name, "w") as file:
            file["tforms"] = poses
    with pytest.raises(ConfigurationError, match="calibration ImageToProbe is missing"):
        TrackedFrames(path)
    rows = np.concatenate([PIXEL, CALIBRATION @ np.linalg.inv(PIXEL)])
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    text = ["scaling_from_pixel_to_mm", *lines[:4], "spatial_calibration", *lines[4:]]
    (tmp_path / "calib_matrix.csv").write_text("\n".join(text))
    assert_same_frames(TrackedFrames(path), frames)
    with pytest.raises(ConfigurationError, match="--reconstruct"):
        Recording(path)


def write_pngs(folder, frames, *, mode="L", quaternions=False):
    folder.mkdir()
    names = [f"frame_{k + 7}.png" for k in range(len(frames))]  # 10 comes after 9
    with (folder / "poses.csv").open("w", newline="") as file:
        columns = ["file", "time_ms"]
        columns += [*"xyz", "qw", "qx", "qy", "qz"] if quaternions else [
            f"m{i}{j}" for i in range(3) for j in range(4)
        ]  # fmt: skip
        table = csv.writer(file, delimiter=";" if quaternions else ",")
        table.writerow([each.upper() if quaternions else each for each in columns])
        for name, frame, pose in reversed(
            list(zip(names, frames, sensor_poses(frames), strict=True))
        ):
            values = pose[:3].ravel().tolist()
            if quaternions:
                X = RigidTransform(pose)
                values = [*X.translation(), *X.rotation().ToQuaternion().wxyz()]
                name = "C:\\data\\" + name.upper()
            table.writerow([name, 1e3 * frame.time, *values])
    for name, frame in zip(names, frames, strict=True):
        Image.fromarray(frame.pixels.T).convert(mode).save(folder / name)


@pytest.mark.parametrize("mode", ["L", "RGB", "I;16"])
def test_a_folder_of_png_with_a_table_of_poses(tmp_path, frames, mode):
    folder = tmp_path / "pictures"
    write_pngs(folder, frames, mode="L" if mode == "I;16" else mode, quaternions=mode == "RGB")
    if mode == "I;16":
        for path in folder.glob("*.png"):
            Image.fromarray(np.asarray(Image.open(path)).astype(np.uint16)).save(path)
        table = folder / "poses.csv"
        table.write_text(table.read_text(), encoding="utf-16")
    read = TrackedFrames(folder, transforms={"ImageToProbe": CALIBRATION})
    assert_same_frames(read, frames)
    reading = Reading(calibration=" ".join(map(str, CALIBRATION.ravel())))
    assert not [f for f in check_file(folder, reading).findings if "cannot be read" in f.text]


def test_colours_in_some_of_the_images_are_refused(tmp_path, frames):
    """The first images may be grey, and an overlay or flow come later."""
    folder = tmp_path / "pictures"
    write_pngs(folder, frames, mode="RGB")
    pixels = np.asarray(Image.open(folder / "frame_10.png")).copy()
    pixels[:4, :4] = [255, 0, 0]
    Image.fromarray(pixels).save(folder / "frame_10.png")
    with pytest.raises(ConfigurationError, match="--luminance"):
        TrackedFrames(folder, transforms={"ImageToProbe": CALIBRATION})
    with pytest.raises(ConfigurationError, match="frame 3: it is in colour"):
        as_frame(pixels, 1, "frame 3")


def test_columns_that_are_not_read_are_told(tmp_path):
    table = tmp_path / "poses.csv"
    table.write_text("frame,stamp,x,y,z,qw,qx,qy,qz\n0.0,12,1,2,3,1,0,0,0")
    assert read_pose_table(table, ["a.png"])[1] == [
        "columns of poses.csv that are neither times nor poses: stamp"
    ]
    table.write_text("frame,x,y,z,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n1,1,2,lost,1,0,0,0")
    assert read_pose_table(table, ["a.png", "b.png"])[1] == [
        "poses.csv: not all rows give a pose; row 2: column z: 'lost' is no number"
    ]


def test_a_row_that_is_missing_costs_its_frame(tmp_path, frames):
    folder = tmp_path / "pictures"
    write_pngs(folder, frames)
    rows = (folder / "poses.csv").read_text().splitlines()
    odd = rows[5].replace(".", "x", 9)
    (folder / "poses.csv").write_text("\n".join([*rows[:3], *rows[4:5], odd, *rows[6:]]))
    (folder / "frame_8.png").write_bytes(b"damaged")
    read = TrackedFrames(folder, transforms={"ImageToProbe": CALIBRATION})
    assert (len(read), read.notes[-1]) == (6, "left out 2 frames: 2 without a pose (3, 5)")
    assert [frame.any() for frame in read] == [True, False, True, True, True, True]
    assert read.void == {1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file,time,x\na.png,1,2", "x, y, z, qw"),
        ("x,y,z,w,qx,qy,qz\n1,2,3,1,0,0,0", "there is no column qw"),
        (
            "file,x,y,z,qw,qx,qy,qz\na.png,1,2,3,1,0,0,0\na.png,1,2,3,1,0,0,0",
            "rows 1 and 2 are both that of a.png",
        ),
        ("x;y;z;qw;qx;qy;qz\n1,5;2;3;1;0;0;0", "row 1: column x: '1,5' is no number, with a comma"),
        ("time,AngleToo_m00\n1,2", "names no transform"),
        ("file,m00\nb.png,1", "row 1: column file: there is no image 'b.png'; the first one is 'a"),
        ("x,y,z,qw,qx,qy,qz\n1,2,3,90,45,0,0", "row 1: its quaternion has a length other than 1"),
        (
            "m00,m01,m02,m10,m11,m12,m20,m21,m22,m30,m31,m32\n1,0,0,0,1,0,0,0,1,1,2,3",
            "counted from 0; there is no column m03, m13, m23",
        ),
        (
            "m11,m12,m13,m14,m21,m22,m23,m24,m31,m32,m33,m34\n1,0,0,1,0,1,0,2,0,0,1,3",
            "counted from 0; there is no column m00, m01, m02, m03, m10, m20",
        ),
        (
            ",".join(f"m{i}{j}" for i in range(4) for j in range(4))
            + "\n1,0,0,0,0,1,0,0,0,0,1,0,1,2,3,1",
            r"row 1: ProbeToReference: .*its translation is in the last row: transposed\?",
        ),
        ("frame,m00\n1,2", "row 1 is that of frame 1; there are 1"),
        ("Pos1,Pos2\n1,2", r"none of its columns \(Pos1, Pos2\) is part of a pose"),
    ],
)
def test_a_table_that_is_none_is_refused(tmp_path, text, message):
    Image.new("L", (4, 4)).save(tmp_path / "a.png")
    with pytest.raises(ConfigurationError, match=r"poses.csv.*of PNG images, as it holds a.png"):
        TrackedFrames(tmp_path)
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        TrackedFrames(tmp_path)


def write_dicom(path, pixels, *, photometric="MONOCHROME2", region=True, **more):
    """Pixels (n, rows, columns) or with colours at the end."""
    data = pydicom.Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = UltrasoundMultiFrameImageStorage
    data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = generate_uid()
    data.NumberOfFrames, data.Rows, data.Columns = pixels.shape[:3]
    data.SamplesPerPixel = 1 if pixels.ndim == 3 else 3
    data.PhotometricInterpretation = photometric
    data.BitsAllocated = data.BitsStored = 8 * pixels.itemsize
    data.HighBit, data.PixelRepresentation = data.BitsStored - 1, 0
    if pixels.ndim == 4:
        data.PlanarConfiguration = 0
    data.FrameTime = "50"
    if region:
        each = pydicom.Dataset()
        each.RegionSpatialFormat = each.RegionDataType = 1
        each.PhysicalUnitsXDirection = each.PhysicalUnitsYDirection = 3
        each.PhysicalDeltaX, each.PhysicalDeltaY = 0.05, 0.04  # cm
        each.RegionLocationMinX0, each.RegionLocationMinY0 = 3, 7
        each.RegionLocationMaxX1 = int(data.Columns) - 3
        each.RegionLocationMaxY1 = int(data.Rows) - 2
        flow = copy.deepcopy(each)
        flow.RegionDataType, flow.RegionLocationMinX0 = 2, 9
        data.SequenceOfUltrasoundRegions = [flow, each]
    for name, value in more.items():
        setattr(data, name, value)
    data.PixelData = pixels.tobytes()
    data.save_as(path, enforce_file_format=True)


@pytest.mark.parametrize("photometric", ["MONOCHROME2", "MONOCHROME1", "RGB"])
def test_multi_frame_ultrasound_of_dicom(tmp_path, frames, photometric):
    pixels = np.array([np.pad(frame.pixels.T, ((7, 1), (3, 2))) for frame in frames])
    if photometric == "MONOCHROME1":
        pixels = 255 - pixels
    if photometric == "RGB":
        pixels = np.repeat(pixels[..., np.newaxis], 3, axis=-1)
    path = tmp_path / "cine.dcm"
    write_dicom(path, pixels, photometric=photometric)
    with pytest.raises(ConfigurationError, match="table of poses"):
        TrackedFrames(path)
    # The region's scale is the size of the pixels; the pose is that of the whole picture's first.
    mm, first = np.diag([1e3, 1e3, 1e3, 1.0]), np.eye(4)
    first[:2, 3] = -3, -7
    poses = [mm @ frame.X_WI @ first @ np.linalg.inv(PIXEL) for frame in frames]
    names = [f"ProbeToTracker_{i}{j}" for i in range(3) for j in range(4)]
    lines = [",".join(map(repr, pose[:3].ravel().tolist())) for pose in poses]
    path.with_suffix(".csv").write_text("\n".join([",".join(names), *lines]))
    read = TrackedFrames(path)
    assert_same_frames(read, frames)
    assert "cut to the region of tissue, 40 x 50 pixels from 3, 7" in " ".join(read.notes)


def test_colours_of_dicom_and_palettes_are_refused(tmp_path, frames):
    pixels = np.array([frame.pixels.T for frame in frames])
    colours = np.stack([pixels, pixels, 255 - pixels], axis=-1)
    path = tmp_path / "cine.dcm"
    path.with_suffix(".csv").write_text("x,y,z,qw,qx,qy,qz\n" + "0,0,0,1,0,0,0\n" * len(frames))
    write_dicom(path, colours, photometric="RGB")
    with pytest.raises(ConfigurationError, match="colours"):
        TrackedFrames(path)
    write_dicom(path, pixels, photometric="PALETTE COLOR")
    with pytest.raises(ConfigurationError, match="palettes"):
        TrackedFrames(path)
    write_dicom(path, pixels, SOPClassUID=EnhancedUSVolumeStorage)
    with pytest.raises(ConfigurationError, match="volumes of DICOM"):
        TrackedFrames(path)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ConfigurationError, match="no DICOM file"):
        TrackedFrames(path)


def test_volumes_go_to_zea_and_come_back(tmp_path):
    made = [Scene(spacing=1.5e-3).volume(k, None, RigidTransform([0, 0, 1e-3 * k])) for k in (0, 1)]
    path = tmp_path / "a.hdf5"
    with ZeaWriter(path) as writer:
        for volume in made:
            writer.append(volume, volume.intensities > 200)
    with h5py.File(path) as file:
        pixels = file["data/image_sc/pixels"]
        assert pixels.shape == (2, *made[0].intensities.shape)  # frames, x, z (depth), y
        assert file["data/segmentation/pixels"].shape == (*pixels.shape, 1)
        low, high = made[0].origin, made[0].upper
        extent = [low[0], high[0], low[2], high[2], high[1], low[1]]
        np.testing.assert_allclose(file["data/image_sc/extent"], extent, atol=1e-8)
    recording = open_volumes(path)
    np.testing.assert_allclose(recording.times, [each.time for each in made], atol=1e-6)
    for volume, wanted in zip(recording, made, strict=True):
        np.testing.assert_array_equal(volume.intensities, wanted.intensities)
        here = volume.to_world(volume.position([[3, 4, 5]]))[0]
        np.testing.assert_allclose(
            here, wanted.X_WP.multiply(wanted.position([[3, 4, 5]]).T).T, atol=1e-6
        )
    with ZeaWriter(tmp_path / "b.hdf5") as writer:
        writer.append(made[0])
        with pytest.raises(ValueError, match="grid"):
            writer.append(Scene(spacing=2e-3).volume(0))


def _change(name, change):
    """Return a function that replaces an array of an HDF5 file."""

    def changed(file):
        there = file[name][()]
        del file[name]
        file[name] = change(there)

    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            _change("data/image_sc/extent", lambda extent: extent[[0, 1, 2, 3, 5, 4]]),
            r"extent: zmax, 0 m, is not above zmin, 0\.\d+ m; its numbers are xmin, xmax",
        ),
        (
            _change("metadata/volume_time/samples", lambda times: times[:1]),
            r"metadata/volume_time/samples: their shape is \(1,\); expected \(2,\)",
        ),
        (
            _change("metadata/volume_time/samples", lambda times: np.append(times, 2)),
            r"their shape is \(3,\); expected \(2,\)",
        ),
        (
            _change("metadata/probe_pose/samples", lambda poses: poses[:1]),
            r"probe_pose/samples: their shape is \(1, 4, 4\); expected \(2, 4, 4\)",
        ),
        (
            _change(
                "metadata/probe_pose/samples",
                lambda poses: poses + np.outer([50, 0, 0, 0], [0, 0, 0, 1]),
            ),
            r"place of volume 0, \[50.0, 0.0, 0.0\] m, is out of range \(\+-10 m\); is it in mm\?",
        ),
    ],
)
def test_files_of_zea_that_contradict_themselves_are_refused(tmp_path, change, message):
    path = tmp_path / "a.hdf5"
    with ZeaWriter(path) as writer:
        for k in (0, 1):
            writer.append(Scene(spacing=2e-3).volume(k))
    assert len(Recording(path)) == 2
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ConfigurationError, match=message):
        Recording(path)


def test_files_of_zea_without_images_are_refused(tmp_path):
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w") as file:
        file["data/raw_data"] = np.zeros((2, 3, 4, 5, 1), np.int16)
    with pytest.raises(ConfigurationError, match=r"log-compressed images are needed.*raw_data"):
        Recording(path)
    with h5py.File(path, "w") as file:
        file["data/image"] = np.zeros((2, 8, 6), np.float32)
    with pytest.raises(ConfigurationError, match="2D frames"):
        Recording(path)
    with h5py.File(path, "w") as file:
        file["other"] = 1
    with pytest.raises(ConfigurationError, match=r"TUS-REC.*zea"):
        Recording(path)


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_nifti_gives_the_volumes_that_nrrd_gives(tmp_path, name):
    rng = np.random.default_rng(100)
    numbers = rng.integers(0, 256, (20, 22, 24, 3)).astype(np.uint8)
    lps = np.array([[0.0, 0.7, 0.0], [-0.8, 0.0, 0.0], [0.0, 0.0, 0.9]])  # axes as columns
    header = {
        "space": "left-posterior-superior",
        "space directions": np.vstack([lps.T, np.full((1, 3), np.nan)]),
        "space origin": [10.0, -20.0, 30.0],
    }
    nrrd.write(str(tmp_path / "a.nrrd"), numbers, header)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = lps, [10.0, -20.0, 30.0]
    image = nibabel.Nifti1Image(numbers, np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine)
    image.header.set_xyzt_units("mm", "sec")
    image.header["pixdim"][4] = 0.25
    nibabel.save(image, tmp_path / name)
    read, wanted = Recording(tmp_path / name), Recording(tmp_path / "a.nrrd", volume_rate=4.0)
    np.testing.assert_array_equal(read.times, [0.0, 0.25, 0.5])
    for number in range(3):
        np.testing.assert_array_equal(read[number].intensities, wanted[number].intensities)
        np.testing.assert_allclose(read[number].spacing, wanted[number].spacing, rtol=1e-6)
        np.testing.assert_allclose(read[number].origin, wanted[number].origin, atol=1e-8)
        assert read.X_WL(number).IsNearlyEqualTo(wanted.X_WL(number), 1e-6)
    for unit, step, message in (
        ("hz", 0.25, r"--volume-rate.*unit of time \(xyzt_units\) is 'hz'"),
        ("unknown", 0.25, "is 'unknown'"),
        ("sec", 0.0, r"step of time \(pixdim\[4\]\) is 0"),
    ):
        image.header.set_xyzt_units("mm", unit)
        image.header["pixdim"][4] = step
        nibabel.save(image, tmp_path / "b.nii")
        with pytest.raises(ConfigurationError, match=message):
            Recording(tmp_path / "b.nii")
    image.header.set_xyzt_units("mm", "sec")
    image.header["pixdim"][4] = 0.25
    image.set_qform(np.diag([0.7, 0.8, 0.9, 1.0]), code=1)
    nibabel.save(image, tmp_path / "b.nii")
    assert (
        "its sform and its qform differ; the sform is taken" in Recording(tmp_path / "b.nii").notes
    )
    image = nibabel.Nifti1Image(numbers[..., 0], None)
    image.header.set_zooms((0.7, 0.8, 0.9))
    nibabel.save(image, tmp_path / "b.nii")
    header = {"spacings": [0.7, 0.8, 0.9]}
    nrrd.write(str(tmp_path / "b.nrrd"), numbers[..., 0], header)
    read, wanted = Recording(tmp_path / "b.nii"), Recording(tmp_path / "b.nrrd")
    assert read.X_WL(0).IsExactlyEqualTo(wanted.X_WL(0))
    np.testing.assert_allclose(read[0].origin, wanted[0].origin, atol=1e-8)
    assert "its axes to be LPS" in " ".join(read.notes)
    for dtype, message in (
        (np.complex64, "complex"),
        ([(each, "u1") for each in "RGB"], "colours"),
    ):
        nibabel.save(nibabel.Nifti1Image(np.zeros((9, 9, 9), dtype), affine), tmp_path / "b.nii")
        with pytest.raises(ConfigurationError, match=message):
            Recording(tmp_path / "b.nii")
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:300])
    with pytest.raises(ConfigurationError, match="a.nii"):
        Recording(tmp_path / name)


def test_a_file_for_each_volume_is_a_sequence(tmp_path):
    """Files are taken in the order of their numbers, with the poses that their headers state."""
    rng = np.random.default_rng(0)
    levels = rng.integers(1, 256, (11, 9, 8, 7), dtype=np.uint8)
    folder = tmp_path / "volumes"
    folder.mkdir()
    header = {"space": "left-posterior-superior", "space directions": np.diag([0.6, 0.5, 0.7])}
    for number, each in enumerate(levels):
        pose = f"1 0 0 {number} 0 1 0 0 0 0 1 0 0 0 0 1"
        fields = {"ProbeToTrackerTransform": pose, "ProbeToTrackerTransformStatus": "OK"}
        nrrd.write(str(folder / f"v{number}.nrrd"), each, header | fields)
    (folder / "._v1.nrrd").write_bytes(b"what macOS keeps beside a file")
    read = Recording(folder, volume_rate=4)
    assert len(read) == 11
    np.testing.assert_allclose(read[10].time, 2.5)
    np.testing.assert_array_equal(
        np.sort(read[10].intensities, axis=None), np.sort(levels[10], None)
    )
    np.testing.assert_allclose(
        read[10].X_WP.translation() - read[0].X_WP.translation(), [0.01, 0, 0]
    )
    assert not any("numbers are missing" in note for note in read.notes)
    (folder / "v6.nrrd").rename(folder / "v12.nrrd")
    notes = " ".join(Recording(folder, volume_rate=4).notes)
    assert "numbers are missing among the files, such as 6; without times" in notes
    nrrd.write(str(folder / "v11.nrrd"), levels[0, :-1], header)
    with pytest.raises(ConfigurationError, match=r"v11.nrrd: size, spacing, axes or channels"):
        Recording(folder, volume_rate=4)
    sequence = np.moveaxis(levels, 0, -1)[..., np.newaxis, :]
    nibabel.save(nibabel.Nifti1Image(sequence, np.eye(4)), tmp_path / "ants.nii")
    assert len(Recording(tmp_path / "ants.nii", volume_rate=4)) == 11


@pytest.mark.parametrize(
    ("names", "dtype", "fields", "message"),
    [
        ("v0 v1", "i2", {}, "v1.nrrd: its voxels are of the type int16, and those of .*of uint8"),
        (
            "v0 v1",
            "u1",
            {"UltrasoundImageOrientation": "UFA"},
            "v1.nrrd: UltrasoundImageOrientation: UFA; that of .*v0.nrrd is MFA",
        ),
        (
            "v0 v1",
            "u1",
            {"decibels_per_level": "0.3"},
            "v1.nrrd: decibels_per_level: 0.3; that of .*v0.nrrd is missing",
        ),
        ("v0 v0-label", "u1", {}, "v0.nrrd: it cannot be ordered beside v0-label.nrrd"),
        ("t0.5 t0.25", "u1", {}, "t0.25.nrrd: does it come before or after t0.5.nrrd"),
        ("t0.50 t0.25", "u1", {}, ""),
        ("s1_t0.50 s2_t0.25", "u1", {}, ""),
        ("1.2.9 1.2.10", "u1", {}, ""),
    ],
)
def test_files_of_a_folder_that_do_not_belong_together_are_refused(
    tmp_path, names, dtype, fields, message
):
    header = {"space": "left-posterior-superior", "space directions": np.diag([0.6, 0.5, 0.7])}
    stated = {"UltrasoundImageOrientation": "MFA"}
    for name, kind, more in zip(names.split(), ("u1", dtype), ({}, fields), strict=True):
        voxels = np.arange(9 * 8 * 7).reshape(9, 8, 7).astype(kind)
        nrrd.write(str(tmp_path / f"{name}.nrrd"), voxels, header | stated | more)
    if message:
        with pytest.raises(ConfigurationError, match=message):
            list(Recording(tmp_path, volume_rate=4))
    else:
        assert len(Recording(tmp_path, volume_rate=4)) == 2


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "a.h5").write_bytes(b"x")
    with pytest.raises(ConfigurationError, match=r"h5py.*sonoservo\[hdf5\]"):
        Recording(tmp_path / "a.h5")
