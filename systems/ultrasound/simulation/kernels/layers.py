"""Layers of bright echoes over the tissue's: transmission, shadows, and their addition."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS

_OPAQUE = np.float32(0.02)


class Layer(NamedTuple):
    """Bright echoes of a frame, with the shadows that they cast."""

    echoes: NDArray[np.float32]
    """(lines, 2 (samples + 2 pad)) echoes, real and imaginary parts alternating."""
    loss: NDArray[np.float32]
    """(lines, samples) shares of the amplitude that each sample takes from those behind it."""
    spans: NDArray[np.int64]
    """(lines, 2) first and last sample (exclusive) that each line uses, counted with the pad."""


@njit(**OPTIONS)
def empty_layer(lines, samples, pad):  # type: ignore[no-untyped-def]
    """Return a layer without echoes."""
    spans = np.zeros((lines, 2), np.int64)
    spans[:, 0] = samples + 2 * pad
    echoes = np.zeros((lines, 2 * (samples + 2 * pad)), np.float32)
    return Layer(echoes, np.zeros((lines, samples), np.float32), spans)


@njit(**INNER)
def touch(layer, line, start, end):  # type: ignore[no-untyped-def]
    """Extend the samples that a line of a layer uses."""
    layer.spans[line, 0] = min(layer.spans[line, 0], start)
    layer.spans[line, 1] = max(layer.spans[line, 1], end)


@njit(**INNER)
def add_layer(iq, layer):  # type: ignore[no-untyped-def]
    """Add a layer to a frame's (lines, samples) complex64 echoes, and empty it."""
    lines, samples = iq.shape
    width = layer.echoes.shape[1] // 2
    pad = (width - samples) // 2
    for j in range(lines):
        first, last = layer.spans[j]
        for i in range(max(first - pad, 0), min(last - pad, samples)):
            at = 2 * (i + pad)
            iq[j, i] += complex(layer.echoes[j, at], layer.echoes[j, at + 1])
        if first < last:
            layer.echoes[j, 2 * first : 2 * last] = 0
            layer.loss[j, max(first - pad, 0) : max(last - pad, 0)] = 0
        layer.spans[j, 0] = width
        layer.spans[j, 1] = 0


@njit(**INNER)
def cast_shadows(transmission, layer, margin):  # type: ignore[no-untyped-def]
    """Weaken a frame's (lines, samples) transmission, and its layer, behind surfaces.

    A surface does not shadow its own echo: its loss affects the layer only from ``margin`` samples
    behind it.
    """
    lines, samples = layer.loss.shape
    pad = (layer.echoes.shape[1] // 2 - samples) // 2
    for j in range(lines):
        if layer.spans[j, 1] == 0:
            continue
        taken = np.float32(0)
        late = np.float32(0)
        for i in range(samples):
            through = transmission[j, i] * max(np.float32(1) - late, np.float32(0))
            layer.echoes[j, 2 * (i + pad)] *= through
            layer.echoes[j, 2 * (i + pad) + 1] *= through
            through = np.float32(1) - taken
            # Pieces cover an opaque surface to within one per cent.
            transmission[j, i] *= through if through > _OPAQUE else np.float32(0)
            taken += layer.loss[j, i]
            if i >= margin:
                late += layer.loss[j, i - margin]


@njit(**INNER)
def join_layer(iq, transmission, layer, weakened):  # type: ignore[no-untyped-def]
    """Weaken a frame's echoes on the lines that a layer uses, or on all, and add the layer."""
    for j in range(iq.shape[0]):
        if layer.spans[j, 1] > 0 or weakened:
            for i in range(iq.shape[1]):
                iq[j, i] *= transmission[j, i]
    add_layer(iq, layer)


@njit(**OPTIONS)
def expand_gains(transmission, gains, nodes_per_sample):  # type: ignore[no-untyped-def]
    """Interpolate (frames, lines, nodes) gains to the samples of a transmission."""
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
