"""Random numbers of stateless systems."""

from zlib import crc32

import numpy as np

HELD_OUT = range(100)
"""Seeds of what is reported: methods are tuned on others, whose layouts and needles differ."""


def random_stream(seed: int, purpose: str, time: float) -> np.random.Generator:
    """Return the random generator of one system for one volume.

    It makes a stateless system repeatable. Systems with different purposes draw different numbers.

    Parameters
    ----------
    seed
        Seed that the systems share.
    purpose
        Purpose of the random numbers, such as "detection".
    time
        Time of the volume, in s.
    """
    return np.random.default_rng([seed, crc32(purpose.encode()), int(abs(time) * 1e9)])
