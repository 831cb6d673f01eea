"""Items, volumes and helpers for the tests of live connections."""

import time
from collections.abc import Callable

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.live.connection.open_igt_link import decode, make_framer
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode, Volume

X = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.01, 0.02, 0.03])


def decode_all(data: bytes, piece: int = 1 << 20, framer=None) -> list[Item]:
    """Every item in some bytes that come in pieces."""
    framer, items = framer or make_framer(), []
    while data:
        count = min(len(framer.buffer), len(data), piece)
        framer.buffer[:count] = data[:count]
        for frame in framer.advance(count, 0.0):
            items += decode(frame)
        data = data[count:]
    return items


def make_volume(time: float = 1.0, *, shape=(6, 5, 4), X_WP=X, seed=0) -> Volume:
    grey = np.random.default_rng(seed).integers(0, 255, shape, dtype=np.uint8)
    return Volume(grey, [-0.002, 0.001, -0.003], [7e-4, 8e-4, 9e-4], X_WP, time)


def make_estimate(order: int = 2, volume_time: float = 1.0) -> NeedleEstimate:
    points = np.linspace([0.0, 0.01, 0.0], [0.01, 0.03, 0.002], order)
    return NeedleEstimate(
        TrackingMode.TRACKING,
        volume_time + 0.02,
        NeedleCurve(points),
        np.zeros((order, 3)),
        1e-8 * np.eye(6 * order),
        volume_time,
    )


class FakeOutlet:
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, list[Item]]] = []

    def send(self, items: list[Item], topic: str = "", keep: int | None = None) -> None:
        self.sent.append((topic, list(items)))


def wait_until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for something that another thread or program does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)
