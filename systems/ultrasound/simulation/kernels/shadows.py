"""Transmission of the tissue, shadows of surfaces, and addition of their echoes to the tissue's."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import OPTIONS

_OPAQUE = np.float32(0.02)


@njit(**OPTIONS)
def cast_shadows(transmission, layer, loss, touched, margin, pad):  # type: ignore[no-untyped-def]
    """Weaken a frame's (lines, samples) transmission, and its layer, behind surfaces.

    A surface does not shadow its own echo: its loss affects the layer only from ``margin`` samples
    behind it.
    """
    lines, samples = loss.shape
    for j in range(lines):
        if not touched[j]:
            continue
        taken = np.float32(0)
        late = np.float32(0)
        for i in range(samples):
            through = transmission[j, i] * max(np.float32(1) - late, np.float32(0))
            layer[j, 2 * (i + pad)] *= through
            layer[j, 2 * (i + pad) + 1] *= through
            through = np.float32(1) - taken
            # Pieces cover an opaque surface to within one per cent.
            transmission[j, i] *= through if through > _OPAQUE else np.float32(0)
            taken += loss[j, i]
            if i >= margin:
                late += loss[j, i - margin]


@njit(**OPTIONS)
def join_layer(iq, transmission, layer, touched, weakened, pad):  # type: ignore[no-untyped-def]
    """Weaken a frame's echoes and add its layer, on the lines that either touches."""
    for j in range(iq.shape[0]):
        if touched[j]:
            for i in range(iq.shape[1]):
                echo = complex(layer[j, 2 * (i + pad)], layer[j, 2 * (i + pad) + 1])
                iq[j, i] = iq[j, i] * transmission[j, i] + echo
        elif weakened:
            for i in range(iq.shape[1]):
                iq[j, i] *= transmission[j, i]


@njit(**OPTIONS)
def expand_gains(transmission, gains, nodes_per_sample):  # type: ignore[no-untyped-def]
    """Interpolate gains to samples.

    Parameters
    ----------
    transmission, gains
        (frames, lines, samples) float32 transmission, written, and (frames, lines, nodes) gains.
    nodes_per_sample
        Number of nodes from one sample to the next.
    """
    frames, lines, samples = transmission.shape
    last = gains.shape[2] - 2
    for frame in range(frames):
        for j in range(lines):
            for i in range(samples):
                node = i * nodes_per_sample
                k = min(np.int64(node), last)
                near = gains[frame, j, k]
                share = np.float32(min(node - k, 1.0))
                transmission[frame, j, i] = near + share * (gains[frame, j, k + 1] - near)
