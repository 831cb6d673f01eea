"""Scatterers that fill the tissue: a periodic tile, divided into blocks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import LANES

BLOCKS = 8
"""Number of blocks along an edge of the scatterer tile."""

_SCATTERERS_PER_BLOCK = 160
_MAX_BLOCK = 4e-3


class ScattererTile(NamedTuple):
    """Scatterers that fill the tissue frame periodically.

    The cube is divided into blocks, so that a thin slab of the tissue can be gathered without
    visiting the rest. The whole tile stays in a processor's cache.
    """

    block_size: float
    """Edge of a block in m; the tile's edge is `BLOCKS` times that."""
    positions: NDArray[np.float32]
    """(3, n + LANES) positions within the block, in m; the last ones are never used."""
    ranks: NDArray[np.float32]
    """(n + LANES,) numbers in [0, 1), rising within a block: a random share p lies below p."""
    starts: NDArray[np.int64]
    """(BLOCKS^3 + 1,) first scatterers of the blocks, with x varying slowest."""


def scatterer_tile(density: float, rng: np.random.Generator) -> ScattererTile:
    """Fill a tile with independent scatterers, ``density`` in a m^3."""
    block_size = min((_SCATTERERS_PER_BLOCK / density) ** (1 / 3), _MAX_BLOCK)
    counts = rng.poisson(density * block_size**3, BLOCKS**3)
    starts = np.concatenate([[0], np.cumsum(counts)])
    ranks = rng.random(starts[-1], dtype=np.float32)
    block = np.repeat(np.arange(BLOCKS**3), counts)
    return ScattererTile(
        block_size=block_size,
        positions=np.pad(
            (rng.random((3, starts[-1])) * block_size).astype(np.float32), ((0, 0), (0, LANES))
        ),
        ranks=np.pad(ranks[np.lexsort((ranks, block))], (0, LANES)),
        starts=starts,
    )
