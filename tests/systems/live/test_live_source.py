"""Damaged streams: whatever comes, the next sound volume is tracked."""

import json
import resource
import socket
import threading
import time

import numpy as np
import pytest
from live_items import X, make_estimate, make_volume, wait_until

from sonoservo.systems.live import Link, LiveSource, NeedleNames, parse_address
from sonoservo.systems.live.connection.framing import pack_frame
from sonoservo.systems.live.connection.items import ImageItem, PoseItem, TextItem
from sonoservo.systems.live.connection.open_igt_link import encode
from sonoservo.systems.live.feeds import needle_items, volume_items

SOUND = [
    *(encode(item) for item in volume_items(make_volume(5.0))),
    *(encode(item) for item in needle_items(make_estimate(), NeedleNames(), 5.0)),
    encode(TextItem("Acquisition", 5.0, "{}")),
]


def damaged(rng):
    """A message with one of the faults that a broken or hostile sender can make."""
    data = bytearray(SOUND[rng.integers(len(SOUND))])
    kind = rng.integers(6)
    if kind == 0:  # bits flip anywhere
        for at in rng.integers(len(data), size=rng.integers(1, 8)):
            data[at] ^= 1 << rng.integers(8)
    elif kind == 1:  # torn
        del data[rng.integers(len(data)) :]
    elif kind == 2:  # sound frame, damaged content
        content = bytearray(data[58:])
        for at in rng.integers(max(len(content), 1), size=4):
            content[at : at + 1] = rng.bytes(1)
        name = data[2:14].rstrip(b"\0").decode()
        return pack_frame(name, "Image_Probe", float(rng.uniform(0, 10)), bytes(content))
    elif kind == 3:  # another length
        content = bytes(data[58 : 58 + rng.integers(len(data))]) + rng.bytes(rng.integers(40))
        name = ("IMAGE", "TRANSFORM", "TDATA", "STRING", "NDARRAY", "POINT")[rng.integers(6)]
        return pack_frame(name, "Image_Probe", 5.0, content)
    elif kind == 4:  # stamps that jump
        stamp = (0.0, 1e-9, 4e9, 5.0)[rng.integers(4)]
        return encode(PoseItem("ProbeToReference", stamp, X))
    else:  # noise
        return rng.bytes(rng.integers(200))
    return bytes(data)


STRANGE = {
    "tracker_seed": "abc",
    "spacing": [1e-300, 1e-3, 1e-3],
    "time": 10**400,
    "geometry": {"samples": 10**9},
    "origin": [[]],
}
"""Fields that make a text about an acquisition a hostile one."""


def hostile(rng):
    """Damage, or a sound message that says something impossible."""
    if rng.random() < 0.7:
        return damaged(rng)
    text, pose, image = volume_items(make_volume(float(rng.uniform(0, 9e9) // 3)))
    kind = rng.integers(4)
    if kind == 0:
        field = list(STRANGE)[rng.integers(len(STRANGE))]
        said = json.loads(text.text) | {field: STRANGE[field]}
        return encode(TextItem(text.name, text.time, json.dumps(said)))
    if kind == 1:  # announces much, sends little
        head = bytearray(encode(image)[:58])
        head[42:50] = int(rng.integers(1 << 28)).to_bytes(8, "big")
        return bytes(head) + rng.bytes(1000)
    if kind == 2:  # a sound volume of nothing, on a grid of its own
        shape = tuple(rng.integers(2, 9, 3))
        nothing = np.full(shape, np.nan, np.float32)
        nothing[0, 0, 0] = rng.random()
        return encode(ImageItem("Image_Probe", pose.time, nothing, image.X_LI))
    return pack_frame("\x1b[2J\nforged", "\x1b]0;x\x07", 1.0, rng.bytes(30))


def attack(port, rng, count, peers):
    """Send hostile messages over so many connections, which are taken up again when cut off."""
    lines: dict[int, socket.socket] = {}
    for _ in range(count):
        each = int(rng.integers(peers))
        try:
            if each not in lines:
                lines[each] = socket.create_connection(("127.0.0.1", port), timeout=20)
            lines[each].sendall(hostile(rng))
        except OSError:  # cut off
            lines.pop(each, None)
    for line in lines.values():
        line.close()


def good_ones(volumes):
    return sum(np.array_equal(each.intensities, make_volume().intensities) for each in volumes)


def test_all_volumes_of_a_good_peer_come_through_beside_64_hostile_ones():
    """Memory stays within what `MAX_HELD` allows, though every header announces up to 256 MB."""
    rng, lines, came, sent, count = np.random.default_rng(101), [], [], 30, 2000
    threads, before = threading.active_count(), resource_in_use()
    with LiveSource(parse_address("igtl://:0"), keep=64, report=lines.append) as source:
        address = parse_address(f"igtl://localhost:{source.link.port}")
        attacker = threading.Thread(target=attack, args=(source.link.port, rng, count, 64))
        attacker.start()
        wait_until(lambda: source.link.peers > 10)
        with Link(address, report=lambda _: None) as good:
            wait_until(lambda: good.peers)
            most = 0.0
            for number in range(sent):
                good.send(volume_items(make_volume(5.0 + 0.3 * number)), keep=64)
                while volume := source.take(0.05):
                    came.append(volume)
                most = max(most, resource_in_use() - before)
            attacker.join()
            while good_ones(came) < sent and (volume := source.take(10.0)):
                came.append(volume)
    assert good_ones(came) == sent
    assert [each.time for each in came] == sorted(each.time for each in came)
    assert threading.active_count() <= threads
    assert all(line.isprintable() for line in lines), lines
    assert most < 200
    assert len(lines) < 100 + count / 10


@pytest.mark.slow
def test_20_volumes_a_second_for_five_minutes_without_growth_of_memory():
    seconds, rate = 300, 20
    volume = make_volume(shape=(128, 120, 96))
    memory, came = [], 0
    with Link(parse_address("igtl://:0"), report=print) as server:
        address = parse_address(f"igtl://localhost:{server.port}")
        with LiveSource(address, keep=4, report=print) as source:
            wait_until(lambda: server.peers)

            def send():
                start = time.perf_counter()
                for number in range(seconds * rate):
                    time.sleep(max(0.0, start + number / rate - time.perf_counter()))
                    sent = type(volume)(
                        volume.intensities, volume.origin, volume.spacing, X, 1.0 + number / rate
                    )
                    server.send(volume_items(sent), topic="volume", keep=2)

            thread = threading.Thread(target=send)
            thread.start()
            while thread.is_alive() or source.take(0.5):
                came += bool(source.take(0.5))
                memory.append(resource_in_use())
            thread.join()
    settled = memory[len(memory) // 5 :]
    growth = np.polyfit(np.arange(len(settled)), settled, 1)[0] * len(settled)
    print(f"{came} of {seconds * rate} volumes, {source.dropped} dropped here, {growth:.1f} MB")
    assert came > 0.98 * seconds * rate
    assert growth < 5


def resource_in_use():
    """Memory of this process in MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6
