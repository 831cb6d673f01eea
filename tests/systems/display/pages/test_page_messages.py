import math
import os

import pytest
import umsgpack

from sonoservo.systems.display.pages.page_messages import checked_message

GAMEPAD = {"index": 0, "button_values": [0, 0.5], "axes": [1, -0.25]}
ALLOWED = [
    {"type": "button", "name": "pause"},
    {"type": "slider", "name": "depth (mm) S W", "value": 30.0},
    {"type": "gamepad", "name": "", "gamepad": GAMEPAD},
    {"type": "gamepad", "name": "", "gamepad": {}},
    {"type": "camera_pose", "camera_pose": [1.0] * 16, "is_perspective": True},
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
    {"type": "camera_pose", "camera_pose": [1.0] * 15, "is_perspective": True},
    {"type": "camera_pose", "camera_pose": [1.0] * 16, "is_perspective": 1},
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
