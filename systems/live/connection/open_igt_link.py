"""OpenIGTLink: its messages from and to `Item`s. Millimetres and RAS end here.

The header leaves open in which axes a TRANSFORM or a POINT is meant. 3D Slicer takes them, and the
matrix of an IMAGE, as RAS; so everything is sent as RAS, and an IMAGE says so. What is received
without a flag counts as RAS too. The layouts are those of the protocol's specification, version 3.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.volume_file import MAX_POSITION
from sonoservo.systems.live.connection.framing import (
    MAX_BODY,
    Frame,
    Framer,
    MessageError,
    pack_frame,
)
from sonoservo.systems.live.connection.items import (
    CovarianceItem,
    CurveItem,
    ImageItem,
    Item,
    PointsItem,
    PoseItem,
    StatusItem,
    TextItem,
)
from sonoservo.systems.recording.grey_levels import luminance

_FLIP = np.diag([-1.0, -1.0, 1.0])  # From LPS to RAS and back
_MM = 1e3
_MAX_TEXT = 0xFFFF
_FLOAT64, _OK, _NOT_READY = 11, 1, 13
_UTF8 = 106  # Number of UTF-8 in IANA's list of character sets
_BIG, _LITTLE = 1, 2
_RAS, _LPS = 1, 2
_TYPES = {2: "i1", 3: "u1", 4: "i2", 5: "u2", 6: "i4", 7: "u4", 10: "f4", 11: "f8"}
_CODES = {np.dtype(each): code for code, each in _TYPES.items()}

_IMAGE = struct.Struct("> H 4B 3H 12f 6H")
_POINT = struct.Struct("> 64s 32s 4B 4f 20s")
# A named point with a quaternion, real part first, as pyigtl sends them.
_POSITION = struct.Struct("> 64s 32s 4B 8f 20s")
_TOOL = struct.Struct("> 20s 2B 12f")
_QUATERNION_TOOL = struct.Struct("> 20s 2B 7f")
_STATUS = struct.Struct("> H q 20s")


def make_framer() -> Framer:
    """Return what cuts a connection's bytes into messages of the types that `decode` knows."""
    return Framer({kind: most for kind, (_, most) in _DECODERS.items()})


def encode(item: Item) -> bytes:
    """Return the message for an item; a ValueError if its name or time cannot be sent."""
    kind, content = _encoded(item)
    return pack_frame(kind, item.name, item.time, content)


def decode(frame: Frame) -> list[Item]:
    """Return what a message holds, if of use; a MessageError if it makes no sense."""
    if frame.fault:
        raise MessageError(f"{frame.header.type} {frame.header.device!r}: {frame.fault}")
    if frame.content is None:
        return []
    header = frame.header
    try:
        with np.errstate(all="ignore"):
            return _DECODERS[header.type][0](header.device, header.time, frame.content)
    except Exception as error:  # whatever a foreign message sets off costs that message alone
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MessageError(f"{header.type} {header.device!r}: {reason}") from error


def _encoded(item: Item) -> tuple[str, bytes]:
    match item:
        case ImageItem():
            return "IMAGE", _pack_image(item)
        case PoseItem():
            R = _FLIP @ item.X.rotation().matrix() @ _FLIP
            return "TRANSFORM", _floats([*R.T, _MM * _FLIP @ item.X.translation()])
        case PointsItem():
            colour, nobody = (255, 255, 0, 255), b""
            return "POINT", b"".join(
                _POINT.pack(b"%d" % number, nobody, *colour, *point, 0.0, nobody)
                for number, point in enumerate(_MM * item.points @ _FLIP)
            )
        case CurveItem():
            return "POLYDATA", _pack_line(_MM * item.points @ _FLIP)
        case StatusItem():
            code = _OK if item.good else _NOT_READY
            return "STATUS", _STATUS.pack(code, 0, b"") + item.text.encode() + b"\0"
        case CovarianceItem():
            array = _MM**2 * _FLIP @ item.covariance @ _FLIP
            head = struct.pack("> B B 2H", _FLOAT64, 2, *array.shape)
            return "NDARRAY", head + array.astype(">f8").tobytes()
        case TextItem():
            text = item.text.encode()
            if len(text) > _MAX_TEXT:
                raise ValueError(f"{item.name}: a text of {len(text)} bytes is too long to send")
            return "STRING", struct.pack("> H H", _UTF8, len(text)) + text
    raise TypeError(f"{type(item).__name__} has no OpenIGTLink message")


def _pack_line(points: NDArray[np.float64]) -> bytes:
    """Return the body of a POLYDATA with one line through all points."""
    cell = np.array([len(points), *range(len(points))], ">u4").tobytes()
    counts = struct.pack("> 10I", len(points), 0, 0, 1, len(cell), 0, 0, 0, 0, 0)
    return counts + points.astype(">f4").tobytes() + cell


def _pack_image(item: ImageItem) -> bytes:
    voxels = item.voxels.astype(item.voxels.dtype.newbyteorder("<"), copy=False)
    code, size = _CODES.get(item.voxels.dtype.newbyteorder("=")), voxels.shape
    if code is None:
        raise ValueError(f"{item.name}: numbers of type {voxels.dtype} cannot be sent")
    matrix = _MM * (_FLIP @ item.X_LI[:3])
    centre = matrix @ [*(0.5 * (np.array(size) - 1)), 1.0]
    geometry = [*matrix[:, :3].T.ravel(), *centre]
    head = _IMAGE.pack(1, 1, code, _LITTLE, _RAS, *size, *geometry, 0, 0, 0, *size)
    return head + voxels.tobytes("F")


def _decode_image(name: str, time: float, content: memoryview) -> list[Item]:
    _, components, code, endian, space, *rest = _IMAGE.unpack(content[: _IMAGE.size])
    size, numbers, first, part = rest[:3], rest[3:15], rest[15:18], rest[18:]
    if any(first) or part != size:
        raise ValueError("parts of volumes (subvolumes) are not taken")
    if endian not in (_BIG, _LITTLE):
        raise ValueError(f"a byte order of {endian} is not known")
    if code not in _TYPES:
        raise ValueError(f"numbers of type {code} are not known")
    kind = np.dtype(_TYPES[code]).newbyteorder("<" if endian == _LITTLE else ">")
    voxels = np.frombuffer(content[_IMAGE.size :], kind)
    if voxels.size != components * np.prod(size, dtype=object) or voxels.size == 0:
        raise ValueError(f"{voxels.size} numbers for {size} voxels of {components}")
    if components != 1:
        if components not in (3, 4):
            wanted = "one, or red, green and blue, wanted"
            raise ValueError(f"{components} numbers a voxel; {wanted}")
        voxels = luminance(voxels.reshape(-1, components))
    if voxels.dtype.kind == "f" and not np.isfinite(voxels).any():
        raise ValueError("none of its numbers is finite")
    matrix = np.eye(4)
    matrix[:3] = np.reshape(numbers, (4, 3)).T
    if size[2] == 1 and not matrix[:3, 2].any():  # a 2D frame needs no third direction
        matrix[:3, 2] = np.cross(matrix[:3, 0], matrix[:3, 1])
    matrix[:3, 3] -= matrix[:3, :3] @ (0.5 * (np.array(size) - 1))
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise ValueError("its matrix is no grid in space")
    _require_near(matrix[:3, 3])
    matrix[:3] /= _MM
    if space != _LPS:  # as in the reference library
        matrix[:3] = _FLIP @ matrix[:3]
    return [ImageItem(name, time, voxels.reshape(size, order="F"), matrix)]


def _decode_transform(name: str, time: float, content: memoryview) -> list[Item]:
    return [PoseItem(name, time, _rigid(struct.unpack("> 12f", content)))]


def _decode_tracking_data(name: str, time: float, content: memoryview) -> list[Item]:
    """Each tool of a tracker has a name of its own."""
    return [
        PoseItem(_label(tool) or name, time, _rigid(numbers))
        for tool, _, _, *numbers in _records(_TOOL, content, "tools")
    ]


def _decode_quaternion_tools(name: str, time: float, content: memoryview) -> list[Item]:
    return [
        PoseItem(_label(tool) or name, time, _turned(numbers[:3], numbers[3:]))
        for tool, _, _, *numbers in _records(_QUATERNION_TOOL, content, "tools")
    ]


def _decode_position(name: str, time: float, content: memoryview) -> list[Item]:
    """One position and its quaternion; without a quaternion there is no pose."""
    if len(content) and len(content) % _POSITION.size == 0:
        return [
            PoseItem(_label(point) or name, time, _turned(each[:3], [*each[4:7], each[3]]))
            for point, _, _, _, _, _, *each, _, _ in _POSITION.iter_unpack(content)
        ]
    if len(content) == 12:
        raise ValueError("a position without an orientation is no pose of the probe")
    if len(content) == 24:
        x, y, z, *vector = struct.unpack("> 6f", content)
        real = np.sqrt(max(0.0, 1.0 - float(np.dot(vector, vector))))
        return [PoseItem(name, time, _turned([x, y, z], [*vector, real]))]
    numbers = struct.unpack("> 7f", content)
    return [PoseItem(name, time, _turned(numbers[:3], numbers[3:]))]


def _decode_string(name: str, time: float, content: memoryview) -> list[Item]:
    _, length = struct.unpack("> H H", content[:4])
    if len(content) < 4 + length:
        raise ValueError(f"{len(content) - 4} bytes of a text of {length}")
    return [TextItem(name, time, bytes(content[4 : 4 + length]).decode("utf-8", "replace"))]


def _decode_status(name: str, time: float, content: memoryview) -> list[Item]:
    code, _, _ = _STATUS.unpack(content[: _STATUS.size])
    return [StatusItem(name, time, code == _OK, _label(bytes(content[_STATUS.size :])))]


def _decode_points(name: str, time: float, content: memoryview) -> list[Item]:
    points = np.array([each[6:9] for each in _records(_POINT, content, "points")], float)
    if not np.isfinite(points).all():
        raise ValueError("a point is not finite")
    return [PointsItem(name, time, points.reshape(-1, 3) @ _FLIP / _MM)]


def _decode_polydata(name: str, time: float, content: memoryview) -> list[Item]:
    (count,) = struct.unpack("> I", content[:4])
    points = np.frombuffer(content[40 : 40 + 12 * count], ">f4").reshape(-1, 3).astype(float)
    if len(points) != count or not np.isfinite(points).all():
        raise ValueError("its points are missing or not finite")
    return [CurveItem(name, time, points @ _FLIP / _MM)]


def _decode_array(name: str, time: float, content: memoryview) -> list[Item]:
    kind, axes, rows, columns = struct.unpack("> B B 2H", content[:6])
    if (kind, axes, rows, columns) != (_FLOAT64, 2, 3, 3):
        return []
    array = np.frombuffer(content[6:], ">f8").reshape(3, 3).astype(float)
    return [CovarianceItem(name, time, _FLIP @ array @ _FLIP / _MM**2)]


# Most bytes of a message that is no image, and of one with poses: some hundred tools.
_SMALL, _POSES = 1 << 20, 1 << 16
# Decoder of each type, and the most bytes of its body.
_DECODERS: dict[str, tuple[Callable[[str, float, memoryview], list[Item]], int]] = {
    "IMAGE": (_decode_image, MAX_BODY),
    "TRANSFORM": (_decode_transform, _POSES),
    "TDATA": (_decode_tracking_data, _POSES),
    "QTDATA": (_decode_quaternion_tools, _POSES),
    "QTRANS": (_decode_position, _POSES),
    "POSITION": (_decode_position, _POSES),
    "STRING": (_decode_string, _SMALL),
    "STATUS": (_decode_status, _SMALL),
    "POINT": (_decode_points, _SMALL),
    "POLYDATA": (_decode_polydata, _SMALL),
    "NDARRAY": (_decode_array, _SMALL),
}


def _label(text: bytes) -> str:
    return text.partition(b"\0")[0].decode("utf-8", "replace").strip()


def _records(record: struct.Struct, content: memoryview, name: str) -> Iterator[tuple[Any, ...]]:
    if len(content) % record.size:
        raise ValueError(f"{len(content)} bytes are no whole number of {name}")
    return record.iter_unpack(content)


def _floats(rows: Iterable[ArrayLike]) -> bytes:
    return np.concatenate([np.ravel(row) for row in rows]).astype(">f4").tobytes()


def _require_near(position: ArrayLike) -> None:
    if np.abs(position).max() > MAX_POSITION:
        raise ValueError(f"its position is beyond {1e-3 * MAX_POSITION:g} m")


def _rigid(numbers: Sequence[float]) -> RigidTransform:
    """Return the motion of three columns and a position, in RAS and mm."""
    columns = np.reshape(numbers, (4, 3)).T
    R = _FLIP @ columns[:, :3] @ _FLIP
    if not np.isfinite(columns).all() or np.abs(R.T @ R - np.eye(3)).max() > 1e-3:
        raise ValueError("its matrix is no rigid motion")
    if np.linalg.det(R) < 0:
        raise ValueError("its matrix is a reflection, no rigid motion")
    _require_near(columns[:, 3])
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), _FLIP @ columns[:, 3] / _MM)


def _turned(position: Sequence[float], xyzw: Sequence[float]) -> RigidTransform:
    """Return the motion of a position and a quaternion, real part last, in RAS and mm."""
    size = float(np.linalg.norm(xyzw))
    if not np.isfinite([*position, size]).all() or abs(size - 1) > 1e-2:
        raise ValueError("its quaternion is no rotation")
    x, y, z, w = np.array(xyzw) / size
    R = RotationMatrix(Quaternion([w, x, y, z])).matrix()
    return _rigid([*R.T.ravel(), *position])
