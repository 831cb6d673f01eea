import base64
import io
import json

import numpy as np
import pytest
from PIL import Image
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.display.textured_quads import (
    encode_png,
    encode_webp,
    gltf_textured_quads,
    text_image,
)
from sonoservo.systems.signals import Plane

PLANE = Plane(RigidTransform(RollPitchYaw(0.3, -0.5, 1.1), [0.1, 0.2, 0.3]), 0.06, 0.04)


def view_content(document, number):
    """Bytes of a buffer view, by the glTF 2.0 specification."""
    view, (buffer,) = document["bufferViews"][number], document["buffers"]
    data = base64.b64decode(buffer["uri"].split(",", 1)[1])
    assert len(data) == buffer["byteLength"]
    assert view["byteOffset"] % 4 == 0
    content = data[view["byteOffset"] :][: view["byteLength"]]
    assert len(content) == view["byteLength"]
    return content


def read(document, accessor):
    """The array of an accessor, by the glTF 2.0 specification."""
    accessor = document["accessors"][accessor]
    columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
    dtype = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    content = view_content(document, accessor["bufferView"])
    array = np.frombuffer(content, dtype).reshape(-1, columns)
    assert len(array) == accessor["count"]
    np.testing.assert_array_equal(accessor["min"], array.min(axis=0))
    np.testing.assert_array_equal(accessor["max"], array.max(axis=0))
    return array


def picture_file(document):
    """Contents of the file of the first picture."""
    return view_content(document, document["images"][0]["bufferView"])


def test_every_pixel_is_at_its_place():
    image = np.arange(6, dtype=np.uint8).reshape(2, 3) * 40
    document = json.loads(gltf_textured_quads([PLANE], [encode_png(image)]))
    (primitive,) = document["meshes"][0]["primitives"]
    x, y, z = read(document, primitive["attributes"]["POSITION"]).T
    corners = np.stack([x, -z, y], axis=1)  # glTF's +Y is Drake's +Z
    u, v = read(document, primitive["attributes"]["TEXCOORD_0"]).T
    # Pixel (row, column) has its centre at u = (column + 1/2) / columns, v = (row + 1/2) / rows.
    basis = np.stack([u, v, np.ones(4)], axis=1)
    to_position = np.linalg.lstsq(basis, corners, rcond=None)[0]
    for row in range(2):
        for column in range(3):
            position = [(column + 0.5) / 3, (row + 0.5) / 2, 1] @ to_position
            np.testing.assert_allclose(position, PLANE.grid(2, 3)[row, column], atol=1e-7)
    triangles = read(document, primitive["indices"]).ravel()
    assert set(triangles) == {0, 1, 2, 3}
    area = sum(
        0.5 * np.linalg.norm(np.cross(corners[b] - corners[a], corners[c] - corners[a]))
        for a, b, c in triangles.reshape(-1, 3)
    )
    assert area == pytest.approx(PLANE.width * PLANE.height, rel=1e-5)
    png = Image.open(io.BytesIO(picture_file(document)))
    np.testing.assert_array_equal(np.array(png), image)


def test_a_webp_keeps_the_opacity_and_nearly_the_grey():
    rows, columns = np.mgrid[:40, :60]
    grey = 120 + 80 * np.sin(0.2 * rows) * np.cos(0.1 * columns)
    image = np.stack([grey, 255 * (rows > columns)], axis=-1).astype(np.uint8)
    document = json.loads(gltf_textured_quads([PLANE], [encode_webp(image)]))
    assert document["images"][0]["mimeType"] == "image/webp"
    webp = picture_file(document)
    seen = np.array(Image.open(io.BytesIO(webp)).convert("RGBA"))
    np.testing.assert_array_equal(seen[..., 3], image[..., 1])
    opaque = image[..., 1] > 0
    assert np.abs(seen[opaque, 0].astype(float) - image[opaque, 0]).mean() < 3
    assert len(webp) < len(encode_png(image))


def test_text_is_drawn_whole_on_its_ground():
    image = text_image("tracking", (1.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    assert image.shape[1] > 2 * image.shape[0]
    assert (image[..., 3] == 255).all()
    assert [255, 0, 128] in image[..., :3].reshape(-1, 3).tolist()
    letters = image[..., 0] > 0
    rows, columns = np.flatnonzero(letters.any(axis=1)), np.flatnonzero(letters.any(axis=0))
    assert rows[0] > 0 < columns[0]  # nothing is cut off at an edge
    assert rows[-1] < image.shape[0] - 1
    assert columns[-1] < image.shape[1] - 1
