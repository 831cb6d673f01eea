"""Random numbers of stateless systems."""

from zlib import crc32

import numpy as np


def random_stream(seed: int, purpose: str, time: float) -> np.random.Generator:
    """Return the generator with which one block draws for one volume.

    A stateless system that draws from it repeats itself, and no two blocks draw the same numbers.

    Parameters
    ----------
    seed
        Seed that the blocks share.
    purpose
        What is drawn for, such as "detection".
    time
        Time of the volume, in s.
    """
    return np.random.default_rng([seed, crc32(purpose.encode()), int(abs(time) * 1e9)])
