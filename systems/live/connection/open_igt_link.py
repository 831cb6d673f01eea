"""OpenIGTLink: its messages from and to `Item`s. Millimetres and RAS end here.

The header leaves open in which axes a TRANSFORM or a POINT is meant. 3D Slicer takes them, and the
matrix of an IMAGE, as RAS; so everything is sent as RAS, and an IMAGE says so. What is received
without a flag counts as RAS too. The bodies are packed by pyigtl's message classes; the checksum,
the types that pyigtl lacks, and the checks of what is received are here.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live.connection.framing import Frame, Framer, MessageError, pack_frame
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

try:
    from pyigtl import messages
except ImportError as error:
    raise ConfigurationError(
        "OpenIGTLink needs the package pyigtl: pip install -e '.[live]'"
    ) from error

DEFAULT_PORT = 18944

_FLIP = np.diag([-1.0, -1.0, 1.0])
"""From LPS to RAS and back."""

_MM = 1e3
_MAX_TEXT = 0xFFFF
_FLOAT64, _OK, _NOT_READY = 11, 1, 13
_TOOL = struct.Struct("> 20s B B 12f")
_STATUS = struct.Struct("> H q 20s")


def make_framer() -> Framer:
    """Return what cuts a connection's bytes into messages of the types that `decode` knows."""
    return Framer(_DECODERS)


def encode(item: Item) -> bytes:
    """Return the message for an item.

    Raises
    ------
    ValueError
        If its name or time cannot be sent.
    """
    kind, content = _encoded(item)
    return pack_frame(kind, item.name, item.time, content)


def decode(frame: Frame) -> list[Item]:
    """Return what a message holds; nothing if it is of no use here.

    Raises
    ------
    MessageError
        If its content makes no sense.
    """
    if frame.fault:
        raise MessageError(f"{frame.header.type} {frame.header.device!r}: {frame.fault}")
    if frame.content is None:
        return []
    header = frame.header
    try:
        with np.errstate(all="ignore"):
            return _DECODERS[header.type](header.device, header.time, frame.content)
    except (ValueError, TypeError, LookupError, NotImplementedError, struct.error) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MessageError(f"{header.type} {header.device!r}: {reason}") from error


def _encoded(item: Item) -> tuple[str, bytes]:
    match item:
        case ImageItem():
            matrix = item.X_LI.copy()
            matrix[:3] = _MM * (_FLIP @ item.X_LI[:3])
            image = messages.ImageMessage(item.voxels.transpose(2, 1, 0), matrix, "ras")
            return "IMAGE", image._pack_content()
        case PoseItem():
            return "TRANSFORM", messages.TransformMessage(_to_ras(item.X))._pack_content()
        case PointsItem():
            points = _MM * item.points @ _FLIP
            names = [f"{number}" for number in range(len(points))]
            return "POINT", messages.PointMessage(points, names)._pack_content()
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
            utf8 = messages.MessageBase.IANA_CHARACTER_SET_UTF8
            return "STRING", struct.pack("> H H", utf8, len(text)) + text
    raise TypeError(f"{type(item).__name__} has no OpenIGTLink message")


def _pack_line(points: NDArray[np.float64]) -> bytes:
    """Return the body of a POLYDATA with one line through all points."""
    cell = np.array([len(points), *range(len(points))], ">u4").tobytes()
    counts = struct.pack("> 10I", len(points), 0, 0, 1, len(cell), 0, 0, 0, 0, 0)
    return counts + points.astype(">f4").tobytes() + cell


def _decode_image(name: str, time: float, content: memoryview) -> list[Item]:
    message = messages.ImageMessage()
    message._unpack_content(content)
    voxels = message.image
    if voxels.ndim != 3 or voxels.size == 0:
        raise ValueError(f"{voxels.shape[::-1]} numbers; one number a voxel is wanted")
    matrix = np.asarray(message.ijk_to_world_matrix, float)
    if voxels.shape[0] == 1 and not matrix[:3, 2].any():  # a 2D frame needs no third direction
        matrix[:3, 2] = np.cross(matrix[:3, 0], matrix[:3, 1])
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise ValueError("its matrix is no grid in space")
    X_LI = np.eye(4)
    X_LI[:3] = matrix[:3] / _MM
    if message.world_coordinate_system == "ras":
        X_LI[:3] = _FLIP @ X_LI[:3]
    return [ImageItem(name, time, voxels.transpose(2, 1, 0), X_LI)]


def _decode_transform(name: str, time: float, content: memoryview) -> list[Item]:
    message = messages.TransformMessage()
    message._unpack_content(content)
    return [PoseItem(name, time, _from_ras(np.asarray(message.matrix, float)))]


def _decode_tracking_data(name: str, time: float, content: memoryview) -> list[Item]:
    """Each tool of a tracker has a name of its own."""
    if len(content) % _TOOL.size:
        raise ValueError(f"{len(content)} bytes are no whole number of tools")
    items: list[Item] = []
    for tool, _, _, *numbers in _TOOL.iter_unpack(content):
        matrix = np.eye(4)
        matrix[:3] = np.reshape(numbers, (4, 3)).T
        label = tool.partition(b"\0")[0].decode("utf-8", "replace").strip()
        items.append(PoseItem(label or name, time, _from_ras(matrix)))
    return items


def _decode_string(name: str, time: float, content: memoryview) -> list[Item]:
    message = messages.StringMessage()
    message._unpack_content(bytes(content))
    return [TextItem(name, time, message.string)]


def _decode_status(name: str, time: float, content: memoryview) -> list[Item]:
    code, _, _ = _STATUS.unpack(content[: _STATUS.size])
    text = bytes(content[_STATUS.size :]).partition(b"\0")[0].decode("utf-8", "replace")
    return [StatusItem(name, time, code == _OK, text)]


def _decode_points(name: str, time: float, content: memoryview) -> list[Item]:
    message = messages.PointMessage()
    message._unpack_content(content)
    points = np.reshape(message.positions, (-1, 3)).astype(float)
    if not np.isfinite(points).all():
        raise ValueError("a point is not finite")
    return [PointsItem(name, time, points @ _FLIP / _MM)]


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


_DECODERS = {
    "IMAGE": _decode_image,
    "TRANSFORM": _decode_transform,
    "TDATA": _decode_tracking_data,
    "STRING": _decode_string,
    "STATUS": _decode_status,
    "POINT": _decode_points,
    "POLYDATA": _decode_polydata,
    "NDARRAY": _decode_array,
}


def _to_ras(X: RigidTransform) -> NDArray[np.float64]:
    matrix = X.GetAsMatrix4()
    matrix[:3, :3] = _FLIP @ matrix[:3, :3] @ _FLIP
    matrix[:3, 3] = _MM * _FLIP @ matrix[:3, 3]
    return matrix


def _from_ras(matrix: NDArray[Any]) -> RigidTransform:
    R = _FLIP @ matrix[:3, :3] @ _FLIP
    if not np.isfinite(matrix).all() or np.abs(R.T @ R - np.eye(3)).max() > 1e-3:
        raise ValueError("its matrix is no rigid motion")
    if np.linalg.det(R) < 0:
        raise ValueError("its matrix is a reflection, no rigid motion")
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), _FLIP @ matrix[:3, 3] / _MM)
