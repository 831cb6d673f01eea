import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from live_items import X, decode_all
from openigtlink import compiled
from pydrake.math import RigidTransform, RotationMatrix
from pyigtl import messages

from sonoservo.systems.live.connection.framing import MessageError, pack_frame
from sonoservo.systems.live.connection.items import (
    CovarianceItem,
    CurveItem,
    ImageItem,
    PointsItem,
    PoseItem,
    StatusItem,
    TextItem,
)
from sonoservo.systems.live.connection.open_igt_link import encode

VOXELS = np.arange(60, dtype=np.uint8).reshape(5, 4, 3)
POINTS = 1e-3 * np.arange(9.0).reshape(3, 3)
COVARIANCE = 1e-6 * np.array([[1, 2, 3], [2, 5, 6], [3, 6, 9]])


def grid(steps=(1e-3, 2e-3, 4e-3), origin=(0.01, 0.02, 0.03), R=None):
    X_LI = np.eye(4)
    X_LI[:3, :3] = (np.eye(3) if R is None else R) * steps
    X_LI[:3, 3] = origin
    return X_LI


ITEMS = [
    ImageItem("Image_Probe", 1.5, VOXELS, grid(R=X.rotation().matrix())),
    PoseItem("ProbeToReference", 2.25, X),
    CurveItem("Needle", 3.0, POINTS),
    PointsItem("Points", 4.0, POINTS),
    TextItem("Text", 5.0, "grüß"),
    StatusItem("Status", 6.0, False, "lost: no needle"),
    CovarianceItem("Covariance", 7.0, COVARIANCE),
]


@pytest.mark.parametrize("dtype", ["u1", "<i2", "<f8"])
@pytest.mark.parametrize("system", ["lps", "ras"])
def test_image_of_pyigtl_in_every_type_and_either_coordinate_system(dtype, system):
    voxels = np.arange(60).reshape(3, 4, 5).astype(dtype)
    matrix = grid(R=RotationMatrix.MakeZRotation(0.3).matrix())
    matrix[:3] *= 1e3
    sent = matrix if system == "lps" else np.diag([-1, -1, 1, 1]) @ matrix
    message = messages.ImageMessage(voxels, sent, system, timestamp=1.5, device_name="I")
    (item,) = decode_all(message.pack())
    np.testing.assert_array_equal(item.voxels, voxels.transpose(2, 1, 0))
    np.testing.assert_allclose(item.X_LI[:3], 1e-3 * matrix[:3], atol=1e-8)


def test_image_of_big_endian_numbers():
    voxels = np.arange(60, dtype="<i2").reshape(5, 4, 3) - 30
    content = bytearray(encode(ImageItem("I", 0, voxels, grid()))[58:])
    content[4] = 1
    content[72:] = np.frombuffer(content[72:], "<i2").astype(">i2").tobytes()
    (item,) = decode_all(pack_frame("IMAGE", "I", 0, bytes(content)))
    np.testing.assert_array_equal(item.voxels, voxels)


@pytest.mark.parametrize("components", [3, 4])
@pytest.mark.parametrize("dtype", ["u1", "<f4"])
def test_colours_become_their_luminance(components, dtype):
    colours = np.random.default_rng(1).integers(0, 250, (3, 4, 5, components)).astype(dtype)
    message = messages.ImageMessage(colours, np.eye(4), device_name="I")
    (item,) = decode_all(message.pack())
    expected = colours[..., :3].astype(float) @ [0.299, 0.587, 0.114]
    assert item.voxels.dtype == colours.dtype
    atol = 1e-3 if dtype == "<f4" else 0.5
    np.testing.assert_allclose(item.voxels, expected.transpose(2, 1, 0), atol=atol)


def test_image_without_a_finite_number_is_left_out():
    voxels = np.full((5, 4, 3), np.nan, np.float32)
    with pytest.raises(MessageError, match="none of its numbers is finite"):
        decode_all(encode(ImageItem("I", 0, voxels, grid())))


@pytest.mark.parametrize("kind", ["QTDATA", "POSITION", "POSITION24", "pyigtl"])
def test_poses_of_quaternions_are_those_of_matrices(kind):
    """In every layout: of tools, of one position, with three numbers, and as pyigtl has it."""
    flip = np.diag([-1.0, -1.0, 1.0])
    w, x, y, z = RotationMatrix(flip @ X.rotation().matrix() @ flip).ToQuaternion().wxyz()
    where = 1e3 * flip @ X.translation()
    if kind == "QTDATA":
        tool = struct.pack("> 20s B B 7f", b"Probe", 2, 0, *where, x, y, z, w)
        (item,) = decode_all(pack_frame("QTDATA", "Tracker", 3.0, tool))
    elif kind == "pyigtl":
        sent = messages.PositionMessage(where, [w, x, y, z], names=["Probe"], device_name="T")
        (item,) = decode_all(sent.pack())
    else:
        numbers = [*where, x, y, z, w][: 7 if kind == "POSITION" else 6]
        content = struct.pack(f"> {len(numbers)}f", *numbers)
        (item,) = decode_all(pack_frame("POSITION", "Probe", 3.0, content))
    assert item.name == "Probe"
    assert item.X.IsNearlyEqualTo(X, 1e-6)


def test_tools_of_tracking_data_have_their_own_names():
    tool = struct.Struct("> 20s B B 12f")
    numbers = [1, 0, 0, 0, 1, 0, 0, 0, 1, 10, 20, 30]
    content = tool.pack(b"Probe", 2, 0, *numbers) + tool.pack(b"", 2, 0, *numbers)
    items = decode_all(pack_frame("TDATA", "Tracker", 3.0, content))
    assert [item.name for item in items] == ["Probe", "Tracker"]
    np.testing.assert_allclose(items[0].X.translation(), [-0.01, -0.02, 0.03])


@pytest.mark.parametrize(
    ("kind", "content", "message"),
    [
        ("TRANSFORM", struct.pack(">12f", *[-1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0]), "reflection"),
        ("TRANSFORM", struct.pack(">12f", *[np.nan] * 12), "no rigid motion"),
        ("TRANSFORM", struct.pack(">12f", *np.eye(4, 3).ravel()[:9], 0, 2e5, 0), "beyond 100 m"),
        ("TRANSFORM", b"short", "TRANSFORM 'D'"),
        ("TDATA", b"short", "no whole number of tools"),
        ("POSITION", bytes(12), "without an orientation"),
        ("POSITION", bytes(28), "no rotation"),
        ("IMAGE", bytes(72), "IMAGE 'D'"),
        ("STRING", b"\0\7\0\2x", "1 bytes of a text of 2"),
        ("POINT", struct.pack(">64s32s4B4f20s", b"", b"", *[0] * 4, *[np.inf] * 4, b""), "finite"),
        ("POLYDATA", struct.pack(">10I", 10**9, *[0] * 9), "missing"),
    ],
)
def test_content_that_makes_no_sense_is_left_out(kind, content, message):
    with pytest.raises(MessageError, match=message):
        decode_all(pack_frame(kind, "D", 0, content))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(at=0, value=struct.pack(">HB", 1, 3)), "60 numbers for .* voxels of 3"),
        (dict(at=3, value=b"\x63"), "numbers of type 99 are not known"),
        (dict(at=4, value=b"\7"), "a byte order of 7 is not known"),
        (dict(at=12, value=struct.pack(">12f", *np.zeros(12))), "no grid in space"),
        (dict(at=60, value=struct.pack(">6H", 1, 0, 0, 2, 4, 3)), "ubvolume"),
    ],
)
def test_image_that_makes_no_sense_is_left_out(change, message):
    content = bytearray(encode(ITEMS[0])[58:])
    content[change["at"] : change["at"] + len(change["value"])] = change["value"]
    with pytest.raises(MessageError, match=message):
        decode_all(pack_frame("IMAGE", "I", 0, bytes(content)))


def test_text_that_is_too_long_is_refused():
    with pytest.raises(ValueError, match="too long"):
        encode(TextItem("T", 0, "x" * 70000))


@pytest.fixture(scope="module")
def referee(tmp_path_factory):
    source = Path(__file__).parents[3] / "openigtlink_referee.cxx"
    return compiled(source, tmp_path_factory.mktemp("referee"))


def test_reference_library_reads_what_we_send(referee):
    data = b"".join(map(encode, ITEMS))
    lines = subprocess.run([referee, "read"], input=data, capture_output=True, check=True)
    read = [line.split() for line in lines.stdout.decode().splitlines()]
    assert [line[-1] for line in read] == ["good"] * len(ITEMS)
    assert [(line[1], float(line[2])) for line in read] == [(i.name, i.time) for i in ITEMS]
    flip = np.diag([-1.0, -1.0, 1.0])
    image, pose, curve, points, text, status, covariance = (line[3:-1] for line in read)
    assert image[:5] == ["5", "4", "3", "3", "1"]
    matrix = np.array(image[5:17], float).reshape(3, 4)
    centre = 1e3 * flip @ (ITEMS[0].X_LI @ [2, 1.5, 1, 1])[:3]
    np.testing.assert_allclose(matrix[:, 3], centre, rtol=1e-6)
    np.testing.assert_allclose(matrix[:, :3], 1e3 * flip @ ITEMS[0].X_LI[:3, :3], rtol=1e-5)
    assert list(map(int, image[17:])) == VOXELS.ravel(order="F").tolist()
    R = flip @ X.rotation().matrix() @ flip
    expected = np.column_stack([R, 1e3 * flip @ X.translation()])
    np.testing.assert_allclose(np.array(pose, float).reshape(3, 4), expected, rtol=1e-6)
    assert curve[:2] == ["1", "3"]
    for numbers in (curve[2:], points):
        got = np.array(numbers, float).reshape(3, 3)
        np.testing.assert_allclose(got, 1e3 * POINTS @ flip, rtol=1e-6)
    assert text == ["grüß"]
    assert status == ["13", "lost:", "no", "needle"]
    got = np.array(covariance[1:], float).reshape(3, 3)
    np.testing.assert_allclose(got, 1e6 * flip @ COVARIANCE @ flip, rtol=1e-12)


def test_we_read_what_the_reference_library_sends(referee):
    data = subprocess.run([referee, "write"], capture_output=True, check=True).stdout
    pose, image, tool, text, status, points, curve, covariance = decode_all(data)
    assert {item.time for item in decode_all(data)} == {1700000000.25}
    turn = RigidTransform(RotationMatrix.MakeZRotation(np.pi / 2), [-0.01, -0.02, 0.03])
    assert pose.X.IsNearlyEqualTo(turn, 1e-7)
    assert (tool.name, tool.X.IsNearlyEqualTo(turn, 1e-7)) == ("ProbeToReference", True)
    np.testing.assert_array_equal(image.voxels.ravel(order="F"), np.arange(60) - 30)
    step = turn.rotation().matrix() @ np.diag([-1, -1, 1]) * [1e-3, 2e-3, 4e-3]
    np.testing.assert_allclose(image.X_LI[:3, :3], step, atol=1e-9)
    centre = image.X_LI @ [2, 1.5, 1, 1]
    np.testing.assert_allclose(centre[:3], turn.translation(), atol=1e-8)
    assert (text.text, status.text, status.good) == ("a text", "all is well", True)
    np.testing.assert_allclose(points.points, [[-0.001, -0.002, 0.003]], atol=1e-9)
    np.testing.assert_allclose(curve.points[1], [-0.004, -0.005, 0.006], atol=1e-9)
    np.testing.assert_allclose(covariance.covariance[2], [-3e-6, -6e-6, 9e-6])
