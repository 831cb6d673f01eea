import struct

import pytest
from live_items import X, decode_all
from pyigtl.messages import StringMessage

from sonoservo.systems.live.connection.framing import (
    HEADER_SIZE,
    MAX_BODY,
    Framer,
    FramingError,
    MessageError,
    pack_frame,
)
from sonoservo.systems.live.connection.items import PoseItem, TextItem
from sonoservo.systems.live.connection.open_igt_link import encode, make_framer


@pytest.mark.parametrize(("name", "time"), [("", 0), ("n" * 21, 0), ("n", -1), ("n", 2.0**32)])
def test_what_cannot_be_sent_is_refused(name, time):
    with pytest.raises(ValueError, match="is not allowed"):
        pack_frame("STATUS", name, time, b"")


@pytest.mark.parametrize("piece", [1, 58, 1000])
def test_messages_may_come_in_any_pieces(piece):
    data = b"".join(encode(TextItem("T", k, f"text {k}")) for k in range(5))
    assert [item.text for item in decode_all(data, piece)] == [f"text {k}" for k in range(5)]


@pytest.mark.parametrize("kind", ["VIDEO", "\u00e9"])
def test_unknown_types_are_skipped_without_being_stored(kind):
    framer = make_framer()
    data = pack_frame(kind, "V", 0, bytes(3_000_000)) + encode(PoseItem("P", 1, X))
    assert [item.name for item in decode_all(data, framer=framer)] == ["P"]
    head = pack_frame("VIDEO", "V", 0, bytes(20_000_000))[:HEADER_SIZE]
    framer.buffer[:HEADER_SIZE] = head
    assert list(framer.advance(HEADER_SIZE, 0)) == []
    assert len(framer.buffer) < 1 << 20


def test_message_with_a_wrong_checksum_is_left_out_and_the_next_one_is_read():
    damaged = bytearray(encode(TextItem("T", 0, "damaged")))
    damaged[-1] ^= 1
    framer = make_framer()
    with pytest.raises(MessageError, match="STRING 'T': the checksum is wrong"):
        decode_all(bytes(damaged), framer=framer)
    assert [item.text for item in decode_all(encode(TextItem("T", 0, "ok")), framer=framer)] == [
        "ok"
    ]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        (slice(42, 50), struct.pack(">Q", 10**12), "not OpenIGTLink: .* 1000000000000 bytes"),
        (slice(0, 2), struct.pack(">H", 9), "not OpenIGTLink: version 9"),
        (slice(2, 14), bytes(12), "not OpenIGTLink"),
    ],
)
def test_header_that_makes_no_sense_ends_the_connection(field, value, message):
    data = bytearray(encode(TextItem("T", 0, "text")))
    data[field] = value
    with pytest.raises(FramingError, match=message):
        decode_all(bytes(data))


def test_body_that_is_too_large_costs_itself():
    framer = Framer({"STRING": 100})
    data = pack_frame("STRING", "T", 0, bytes(101)) + encode(TextItem("T", 0, "next"))
    with pytest.raises(MessageError, match="101 bytes; at most 100 are taken"):
        decode_all(data[: HEADER_SIZE + 101], framer=framer)
    (item,) = decode_all(data[HEADER_SIZE + 101 :], framer=framer)
    assert item.text == "next"


@pytest.mark.parametrize("version", [2, 3])
def test_metadata_of_later_versions_is_left_aside(version):
    message = StringMessage("text", 5.5, "T")
    message.header_version, message.metadata = 2, {"unit": "mm", "none": ""}
    packed = bytearray(message.pack())
    packed[1] = version
    (item,) = decode_all(bytes(packed))
    assert (item.text, item.time) == ("text", 5.5)


@pytest.mark.parametrize("body", [b"", b"\0" * 11, struct.pack("> H H I I", 12, 9, 9, 0)])
def test_wrong_extended_header_is_left_out(body):
    data = bytearray(pack_frame("STRING", "T", 0, body))
    data[1] = 2
    with pytest.raises(MessageError, match="extended header"):
        decode_all(bytes(data))


def test_header_of_a_large_message_buys_no_time():
    framer = make_framer()
    framer.buffer[:] = struct.pack("> H 12s 20s I I Q Q", 1, b"IMAGE", b"I", 0, 0, MAX_BODY, 0)
    list(framer.advance(HEADER_SIZE, 0.0))
    assert framer.is_overdue(6.0)
    for _ in range(40):
        list(framer.advance(len(framer.buffer), 5.0))
    assert not framer.is_overdue(6.0)
