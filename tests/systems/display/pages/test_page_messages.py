import math
import os
import random
import time
from contextlib import closing, suppress

import pytest
import umsgpack
from meshcat_socket import MeshcatSocket
from pydrake.geometry import Meshcat, MeshcatParams

from sonoservo.systems.display.pages.page_messages import checked_message

GAMEPAD = {"index": 0, "button_values": [0, 0.5], "axes": [1, -0.25]}
ALLOWED = [
    {"type": "button", "name": "pause"},
    {"type": "slider", "name": "depth (mm) S W", "value": 30.0},
    {"type": "gamepad", "name": "", "gamepad": GAMEPAD},
    {"type": "gamepad", "name": "", "gamepad": {}},
]
REFUSED = [
    None, 1, "button", [], {}, {1: 2}, {"type": "set_object"}, {"type": ["button"]},
    {"type": "button"}, {"type": "button", "name": 3}, {"type": "button", "name": "x" * 10_000},
    {"type": "slider", "name": "depth"}, {"type": "slider", "name": "depth", "value": "30"},
    {"type": "slider", "name": "depth", "value": True},
    {"type": "slider", "name": "depth", "value": math.nan},
    {"type": "slider", "name": "depth", "value": -math.inf},
    {"type": "gamepad", "name": ""}, {"type": "gamepad", "gamepad": []},
    {"type": "gamepad", "gamepad": {**GAMEPAD, "index": -1}},
    {"type": "gamepad", "gamepad": {**GAMEPAD, "index": "0"}},
    {"type": "gamepad", "gamepad": {**GAMEPAD, "axes": "x"}},
    {"type": "gamepad", "gamepad": {**GAMEPAD, "axes": [0] * 1000}},
    {"type": "gamepad", "gamepad": {**GAMEPAD, "button_values": [None]}},
    {"type": "camera_pose", "camera_pose": [1.0] * 16, "is_perspective": True},
]  # fmt: skip


@pytest.mark.parametrize("message", ALLOWED)
def test_what_a_page_says_is_passed_on(message):
    assert umsgpack.unpackb(checked_message(umsgpack.packb(message))) == message


@pytest.mark.parametrize("message", REFUSED)
def test_anything_else_is_refused(message):
    with pytest.raises(ValueError, match="it |a number|a list|the gamepad"):
        checked_message(umsgpack.packb(message))


def test_only_known_fields_are_passed_on():
    said = {**ALLOWED[0], "value": 3, "more": {"deep": [1] * 100}}
    assert umsgpack.unpackb(checked_message(umsgpack.packb(said))) == ALLOWED[0]


def test_what_is_torn_or_no_messagepack_is_refused():
    whole = umsgpack.packb(ALLOWED[2])
    for end in range(len(whole)):
        with pytest.raises(ValueError, match="it is not MessagePack"):
            checked_message(whole[:end])
    nested = b"\x91" * 60_000  # a list in a list in a list ...
    huge = b"\xdd\xff\xff\xff\xff"  # a list of four thousand million
    for data in (
        nested,
        huge,
        b"\xc1",
        b"\xd9\x02\xff\xfe",
        b"\x81\x90\x00",
        b"\xd7\xff" + b"\xff" * 8,
    ):
        with pytest.raises(ValueError, match="it is"):
            checked_message(data)
    for _ in range(2000):
        with pytest.raises(ValueError, match="it "):
            checked_message(os.urandom(40))


def damaged(rng):
    """A message of which up to three bytes are changed, lost or added."""
    data = bytearray(umsgpack.packb(rng.choice(ALLOWED)))
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(data))
        data[place : place + rng.randint(0, 1)] = bytes(
            rng.choices(range(256), k=rng.randint(0, 1))
        )
    return bytes(data)


def test_drake_survives_whatever_is_passed_on():
    rng = random.Random(7)
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    meshcat.AddButton("pause")
    meshcat.AddSlider("depth (mm) S W", 0, 100, 1, 5)
    with closing(MeshcatSocket(meshcat)) as page:
        page.read_in_background()
        passed = 0
        for _ in range(20_000):
            with suppress(ValueError):
                page.send(checked_message(damaged(rng)))
                passed += 1
        assert passed > 300
        clicks = meshcat.GetButtonClicks("pause")
        page.click("pause")
        while meshcat.GetButtonClicks("pause") == clicks:  # raises if the server has ended
            time.sleep(0.01)
