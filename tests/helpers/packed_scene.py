"""What a Meshcat would send to a page, read from the messages that it keeps."""

import json

import numpy as np


def transform(meshcat, path):
    """Last 16 numbers of the packed message are the matrix, by columns."""
    packed = meshcat._GetPackedTransform(path)
    numbers = [packed[-9 * i : len(packed) - 9 * (i - 1)] for i in range(16, 0, -1)]
    assert all(number[0] == 0xCB for number in numbers)  # MessagePack's mark of a double
    return np.array([np.frombuffer(n[1:], ">f8")[0] for n in numbers]).reshape(4, 4).T


def boxes(meshcat, path):
    """[least, greatest] x, y, z of each picture of a glTF object, by the document alone."""
    packed = meshcat._GetPackedObject(path).decode(errors="replace")
    document, _ = json.JSONDecoder().raw_decode(packed[packed.index('{"') :])
    found = []
    for primitive in document["meshes"][0]["primitives"]:
        accessor = document["accessors"][primitive["attributes"]["POSITION"]]
        ends = np.array([accessor["min"], accessor["max"]])
        x, y, z = ends[:, 0], -ends[::-1, 2], ends[:, 1]  # glTF's +Y is Drake's +Z
        found.append(np.stack([x, y, z], axis=1))
    return found


def visible(meshcat, path):
    return {0xC3: True, 0xC2: False}[meshcat._GetPackedProperty(path, "visible")[-1]]


def scales(meshcat, path):
    packed = meshcat._GetPackedProperty(path, "scale")
    return [np.frombuffer(packed[-27:][9 * i + 1 : 9 * i + 9], ">f8")[0] for i in range(3)]
