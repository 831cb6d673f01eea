"""Textured rectangles as glTF documents, and the pictures on them."""

import base64
import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.signals.planes import Plane

_FLOAT, _UNSIGNED_SHORT = 5126, 5123
_LINEAR, _CLAMP_TO_EDGE = 9729, 33071
_DATA = "data:application/octet-stream;base64,"


def gltf_textured_quads(planes: Sequence[Plane], pictures: Sequence[bytes]) -> str:
    """Return rectangles with pictures (PNG or WebP) on them as one glTF 2.0 document."""
    data = b""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def view(content: bytes) -> int:
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        data += content + bytes(-len(content) % 4)
        return len(views) - 1

    def store(array: NDArray[Any], kind: str, component: int) -> int:
        low, high = (each(axis=0).ravel().tolist() for each in (array.min, array.max))
        described = {"componentType": component, "count": len(array), "type": kind}
        accessors.append(described | {"bufferView": view(array.tobytes()), "min": low, "max": high})
        return len(accessors) - 1

    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    texture = store(corners.astype("<f4"), "VEC2", _FLOAT)
    triangles = store(np.array([0, 1, 2, 0, 2, 3], "<u2"), "SCALAR", _UNSIGNED_SHORT)
    primitives = []
    for number, plane in enumerate(planes):
        p_S = np.zeros((3, 4))
        p_S[:2] = (corners - 0.5).T * [[plane.width], [plane.height]]
        x, y, z = plane.X_PS.multiply(p_S)
        # Drake's Meshcat turns glTF's +Y up.
        position = store(np.stack([x, z, -y], axis=1).astype("<f4"), "VEC3", _FLOAT)
        places = {"POSITION": position, "TEXCOORD_0": texture}
        primitives.append({"attributes": places, "indices": triangles, "material": number})
    images = [
        {"bufferView": view(picture), "mimeType": _kind(picture)}
        for _, picture in zip(planes, pictures, strict=True)
    ]
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit", "EXT_texture_webp"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": number}},
                "extensions": {"KHR_materials_unlit": {}},
                "alphaMode": "MASK",
                "doubleSided": True,
            }
            for number in range(len(planes))
        ],
        "textures": [
            {"source": number, "sampler": 0, "extensions": {"EXT_texture_webp": {"source": number}}}
            for number in range(len(planes))
        ],
        "samplers": [
            dict.fromkeys(("magFilter", "minFilter"), _LINEAR)
            | dict.fromkeys(("wrapS", "wrapT"), _CLAMP_TO_EDGE)
        ],
        "images": images,
        "accessors": accessors,
        "bufferViews": views,
        # A page fetches each buffer by a request of its own, so there is but one.
        "buffers": [{"uri": _DATA + base64.b64encode(data).decode(), "byteLength": len(data)}],
    }
    return json.dumps(document, separators=(",", ":"))


def gltf_mesh(gltf: str) -> Mesh:
    """Return a glTF document as a shape that Meshcat can draw."""
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(gltf, ".gltf", "textured quads")))


def draw_picture(
    meshcat: Meshcat, path: str, image: NDArray[np.uint8], X: RigidTransform, height: float
) -> None:
    """Draw a picture of a height in m, centred at X: its X runs to the right, its -Y upwards."""
    rows, columns = image.shape[:2]
    plane = Plane(X, height * columns / rows, height)
    meshcat.SetObject(path, gltf_mesh(gltf_textured_quads([plane], [encode_png(image)])))


def text_image(
    text: str, colour: Sequence[float], background: Sequence[float], height: int = 64
) -> NDArray[np.uint8]:
    """Return a text as a (rows, columns, 4) picture of a height in pixels."""
    font = ImageFont.load_default(size=0.7 * height)
    width = int(font.getlength(text) + 0.6 * height)
    image = Image.new("RGBA", (width, height), bytes_of(background))
    middle = (0.5 * width, 0.5 * height)
    ImageDraw.Draw(image).text(middle, text, font=font, fill=bytes_of(colour), anchor="mm")
    return np.array(image)


def encode_png(image: NDArray[np.uint8], compression: int = 6) -> bytes:
    """Return an array as the contents of a PNG file; compression from 1 (fast) to 9 (small)."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(buffer, "PNG", compress_level=compression)
    return buffer.getvalue()


def encode_webp(image: NDArray[np.uint8], quality: int = 85) -> bytes:
    """Return a grey array with opacity as a WebP file, a third of a PNG's size."""
    buffer = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image)).convert("RGBA")
    picture.save(buffer, "WEBP", quality=quality, method=0)
    return buffer.getvalue()


def bytes_of(colour: Sequence[float]) -> tuple[int, ...]:
    """Return red, green and blue from 0 to 1 as the four bytes of an opaque colour."""
    return (*(round(255 * each) for each in colour), 255)


def _kind(picture: bytes) -> str:
    return "image/png" if picture.startswith(b"\x89PNG") else "image/webp"
