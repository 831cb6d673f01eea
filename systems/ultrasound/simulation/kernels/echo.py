"""Echoes of tissue: projection of scatterers onto the samples of scan lines.

The method is COLE (Gao et al. 2009) in two stages. Every scatterer is projected onto its three
nearest scan lines and deposited there with its exact two-way phase and the pulse's envelope. Then
neighbouring lines are blurred to the beam's width, which depends on depth.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.blocks import (
    BLOCKS,
    ScattererTile,
    count_below,
    frame_blocks,
    keep_between,
    keep_inside,
    misses,
)
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    displace,
    displacement_limit,
    frame_field,
    limit_along,
)
from sonoservo.systems.ultrasound.simulation.kernels.line_blur import LineKernel, blur_lines
from sonoservo.systems.ultrasound.simulation.kernels.medium import largest_aside, look_up
from sonoservo.systems.ultrasound.simulation.kernels.needle_push import (
    nearest_on_shaft,
    push_scatterers,
)
from sonoservo.systems.ultrasound.simulation.kernels.projection import (
    gaussian,
    line_coordinates,
    phasor,
    transformed,
)
from sonoservo.systems.ultrasound.simulation.kernels.regions import Regions, weigh_scatterers
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import LANES, deposit

FADE = 0.1
"""Half width, relative to the share of scatterers used at a depth, over which more fade in."""

REACH = 2.6
"""Standard deviations in elevation beyond which scatterers are left out: 0.02 % of the energy."""

_ZERO = np.float32(0)
_HALF = np.float32(0.5)
_ONE = np.float32(1)
_FURTHEST = np.float32(REACH**2 / 2)
_FADE_OUT = np.float32(1 + FADE)
_FADE_WIDTH = np.float32(2 * FADE)
_HALF_DIAGONAL = 3**0.5 / 2
_BENT = 1.15
_NEAR_NEEDLE = 1e-3


class Scattering(NamedTuple):
    """Scatterers of the tissue, and how they show."""

    box: NDArray[np.float64]
    """(2, 3) or (3, 3) bounds of the tissue in T, in m; see `BodySurface.bounds`."""
    tile: ScattererTile
    regions: Regions
    """Regions of other scattering, or `NO_REGIONS`."""
    pulse: NDArray[np.float32]
    """(FRACTIONS + 1, 2 taps) envelope around a scatterer, every value twice."""
    kernel: LineKernel


class _Memory(NamedTuple):
    """Memory for the scatterers of a block, and for transforms of a frame and a block."""

    line: NDArray[np.float32]
    sample: NDArray[np.float32]
    cosine: NDArray[np.float32]
    sine: NDArray[np.float32]
    kept: NDArray[np.bool_]
    chosen: NDArray[np.uint64]
    moved: NDArray[np.float32]
    R: NDArray[np.float32]
    node: NDArray[np.float64]
    F: NDArray[np.float64]
    M: NDArray[np.float64]
    bent: NDArray[np.float64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]


@njit(**OPTIONS)
def _memory(starts):  # type: ignore[no-untyped-def]
    """Return memory for the largest block of a tile."""
    n = 0
    for block in range(starts.size - 1):
        n = max(n, starts[block + 1] - starts[block] + LANES)
    return _Memory(
        np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
        np.empty(n, np.float32), np.empty(n, np.bool_), np.empty(n + 1, np.uint64),
        np.empty((3, n), np.float32), np.empty((3, 3), np.float32), np.empty(15),
        np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)),
        np.empty(3, np.int64), np.empty(3, np.int64),
    )  # fmt: skip


@njit(**OPTIONS)
def render_tissue(iq, sights, rays, tissue, lumens):  # type: ignore[no-untyped-def]
    """Write the tissue's echoes to (frames, lines, samples) complex64 samples.

    ``sights``, ``rays`` and ``tissue`` are `Sights`, `Rays` and `Scattering`; ``lumens`` are
    (2, frames, tubes) radii in m and phases of the blood in rad; see `weigh_scatterers`.
    """
    frames, lines, samples = iq.shape
    pad = len(tissue.kernel.ends) // 2 + 1
    taps = tissue.pulse.shape[1] // 2
    accumulator = np.empty((lines + 2 * pad, 2 * (samples + 2 * taps)), np.float32)
    row = np.empty(2 * samples, np.float32)
    memory = _memory(tissue.tile.starts)
    reach = REACH / np.sqrt(2 * rays.elevation_precision)
    for frame in range(frames):
        accumulator[:] = 0
        field = frame_field(sights.fields, frame)
        _deposit_tissue(
            accumulator, sights, frame, field, rays, tissue, lumens[:, frame], reach, reach.max(),
            memory,
        )  # fmt: skip
        blur_lines(iq[frame], accumulator, tissue.kernel, taps, row)


@njit(**INNER)
def _deposit_tissue(  # type: ignore[no-untyped-def]
    accumulator, sights, frame, field, rays, tissue, lumens, reach, furthest, memory
):
    """Deposit the scatterers that a frame's beam meets.

    The accumulator is (lines + 2 pad, 2 (samples + 2 taps)) float32, real and imaginary parts
    alternating; ``lumens`` is (2, tubes), ``reach`` the (samples,) half width of the beam in
    elevation in m, and ``furthest`` its maximum.
    """
    box, regions, pulse = tissue.box, tissue.regions, tissue.pulse
    view, X_FT = sights.bent, sights.X_FT[frame]
    line, sample, cosine, sine, kept, chosen, moved, R, node, F, M, bent, first, last = memory
    block_size, positions, ranks, starts = tissue.tile
    lines = accumulator.shape[0]
    taps = pulse.shape[1] // 2
    samples = accumulator.shape[1] // 2
    count = samples - 2 * taps
    pad = np.float32((lines - 1) / 2) - rays.middle_line
    lead = np.float32(taps - rays.lead)
    last_line = np.float32(lines - 1.5)
    last_sample = np.float32(samples - taps)
    for i in range(3):
        for j in range(3):
            R[i, j] = X_FT[i, j]
    depth = (count - 1) / rays.samples_per_metre
    half_angle = (rays.middle_line + pad) / rays.lines_per_radian
    twist_per_radian = rays.twist * rays.lines_per_radian
    radius = _HALF_DIAGONAL * block_size
    support = (abs(X_FT[2, 0]) + abs(X_FT[2, 1]) + abs(X_FT[2, 2])) * block_size / 2
    twist_slack = abs(twist_per_radian) * radius
    thickness = furthest + abs(twist_per_radian) * half_angle * (depth + rays.array_radius)
    edge_cosine = np.cos(min(half_angle, np.pi / 2))
    edge_sine = np.sin(min(half_angle, np.pi / 2))
    bends, deforms = len(view.table) > 0, len(sights.fields.counts) > 0
    if not deforms:
        M = X_FT
    A = bent if bends else M
    margin = field.depth + field.widest_push
    widest_bend = largest_aside(view, frame)
    widest = half_angle
    straight_reach = thickness
    if bends:
        # Lines bent outwards reach further, and slower tissue appears deeper.
        widest *= _BENT
        thickness += widest_bend
    widest_slope = np.tan(min(widest, 1.5))
    closest = thickness + limit_along(margin, X_FT[2, 2], field)
    frame_blocks(first, last, X_FT, box, block_size, depth, widest, closest, margin, rays)
    for bx in range(first[0], last[0]):
        for by in range(first[1], last[1]):
            for bz in range(first[2], last[2]):
                px, py, pz = (
                    (bx + 0.5) * block_size,
                    (by + 0.5) * block_size,
                    (bz + 0.5) * block_size,
                )
                z = X_FT[2, 0] * px + X_FT[2, 1] * py + X_FT[2, 2] * pz + X_FT[2, 3]
                if abs(z) > closest + support:
                    continue
                x = X_FT[0, 0] * px + X_FT[0, 1] * py + X_FT[0, 2] * pz + X_FT[0, 3]
                y = X_FT[1, 0] * px + X_FT[1, 1] * py + X_FT[1, 2] * pz + X_FT[1, 3]
                near = False
                segment = 0
                thick = support
                if bends or deforms:
                    limit = displacement_limit(px, py, pz, field)
                    if abs(x) - (y + rays.centre_offset) * widest_slope > 2 * (radius + limit):
                        continue
                    aside = limit_along(limit, X_FT[2, 2], field) + widest_bend + support
                    limit += radius + view.furthest
                    if misses(x, y, z, limit, aside, reach, 1.0, twist_per_radian, rays):
                        continue
                if deforms:
                    # Within a block, the displacement is linear, except beside the needle.
                    if field.points > 1:
                        distance, segment = nearest_on_shaft(px, py, pz, field)
                        near = distance < radius + _NEAR_NEEDLE
                    x, y, z = displace(px, py, pz, field, not near, F)
                    x, y, z = transformed(X_FT, x, y, z)
                    for i in range(3):
                        for j in range(3):
                            M[i, j] = (
                                X_FT[i, 0] * F[0, j] + X_FT[i, 1] * F[1, j] + X_FT[i, 2] * F[2, j]
                            )
                            R[i, j] = M[i, j]
                    thick = (abs(M[2, 0]) + abs(M[2, 1]) + abs(M[2, 2])) * block_size / 2
                    if abs(z) > thickness + thick:
                        continue
                if bends:
                    if abs(x) - (y + rays.centre_offset) * widest_slope > 2 * radius:
                        continue
                    # Within a block, the displacement by refraction is taken as linear.
                    x, y, z = look_up(x, y, z, view, frame, node)
                    if abs(z) > straight_reach + thick:
                        continue
                    for i in range(3):
                        for j in range(3):
                            bent[i, j] = (
                                node[3 + 3 * i] * M[0, j]
                                + node[4 + 3 * i] * M[1, j]
                                + node[5 + 3 * i] * M[2, j]
                            )
                            R[i, j] = bent[i, j]
                q = y + rays.centre_offset
                if abs(x) * edge_cosine - q * edge_sine > radius:
                    continue
                r = np.sqrt(q * q + x * x)
                d = r - rays.array_radius
                if d < -radius or d > depth + radius:
                    continue
                at = min(max(np.int64(d * rays.samples_per_metre), 1), count - 2)
                span = min(np.int64(radius * rays.samples_per_metre) + 1, at, count - 1 - at)
                turn = y * twist_per_radian * np.arctan(x / max(q, radius))
                slab = max(reach[at - span], reach[at + span]) + thick + twist_slack
                if abs(z - turn) > slab:
                    continue
                # Within a block, quantities that depend on depth are taken as linear in it.
                per_metre = np.float32(rays.samples_per_metre / (2 * span))
                middle = np.float32(at / rays.samples_per_metre) + rays.array_radius
                precision = rays.elevation_precision[at]
                precision_slope = per_metre * (
                    rays.elevation_precision[at + span] - rays.elevation_precision[at - span]
                )
                curvature = _HALF * rays.curvature[at]
                share = rays.share[at]
                share_slope = per_metre * (rays.share[at + span] - rays.share[at - span])
                block = ((bx % BLOCKS) * BLOCKS + by % BLOCKS) * BLOCKS + bz % BLOCKS
                start = starts[block]
                most = max(rays.share[at + span], rays.share[at - span], share) * (1 + FADE)
                n = count_below(ranks, start, starts[block + 1], np.float32(most))
                # Whole vectors only: the compiler takes up what is left over one by one.
                whole = (n + LANES - 1) // LANES * LANES
                ox = np.float32(x - (A[0, 0] + A[0, 1] + A[0, 2]) * block_size / 2)
                oy = np.float32(y - (A[1, 0] + A[1, 1] + A[1, 2]) * block_size / 2)
                oz = np.float32(z - (A[2, 0] + A[2, 1] + A[2, 2]) * block_size / 2)
                low_x = np.float32(box[0, 0] - bx * block_size)
                low_y = np.float32(box[0, 1] - by * block_size)
                low_z = np.float32(box[0, 2] - bz * block_size)
                high_x = np.float32(box[1, 0] - bx * block_size)
                high_y = np.float32(box[1, 1] - by * block_size)
                high_z = np.float32(box[1, 2] - bz * block_size)
                corner = (bx * block_size, by * block_size, bz * block_size)
                content = -1
                if regions.content.size > 0:
                    content = regions.content[
                        bx - regions.first_block[0],
                        by - regions.first_block[1],
                        bz - regions.first_block[2],
                    ]
                xs = positions[0, start : start + whole]
                ys = positions[1, start : start + whole]
                zs = positions[2, start : start + whole]
                rank = ranks[start : start + whole]
                txs, tys, tzs = xs, ys, zs
                if near:
                    push_scatterers(moved, xs, ys, zs, *corner, segment, field)
                    txs, tys, tzs = moved[0], moved[1], moved[2]
                xx, xy, xz = R[0, 0], R[0, 1], R[0, 2]
                yx, yy, yz = R[1, 0], R[1, 1], R[1, 2]
                zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
                # There is no branch in this loop, so the compiler can vectorise it.
                for i in range(whole):
                    tx = txs[i]
                    ty = tys[i]
                    tz = tzs[i]
                    at_line, e, r_i = line_coordinates(
                        xx * tx + xy * ty + xz * tz + ox,
                        yx * tx + yy * ty + yz * tz + oy,
                        zx * tx + zy * ty + zz * tz + oz,
                        rays,
                    )
                    ahead = r_i - middle
                    p = share + share_slope * ahead
                    u = (precision + precision_slope * ahead) * e * e
                    weight = (p * _FADE_OUT - rank[i]) / (p * _FADE_WIDTH)
                    weight = min(max(weight, _ZERO), _ONE) * gaussian(u)
                    path = r_i - rays.array_radius + curvature * e * e
                    c, s = phasor(path * rays.turns_per_metre)
                    at_line += pad
                    at_sample = path * rays.samples_per_metre + lead
                    line[i] = at_line
                    sample[i] = at_sample
                    cosine[i] = weight * c
                    sine[i] = -weight * s
                    kept[i] = (
                        (u < _FURTHEST)
                        & (weight > _ZERO)
                        & (at_line > _HALF)
                        & (at_line < last_line)
                        & (at_sample > _ZERO)
                        & (at_sample < last_sample)
                    )
                number = 0
                for i in range(n):
                    chosen[number] = i
                    number += kept[i]
                inside = max(low_x, low_y, low_z) < 0 and min(high_x, high_y, high_z) > block_size
                if near or not inside:
                    low, high = (low_x, low_y, low_z), (high_x, high_y, high_z)
                    number = keep_between(chosen, number, txs, tys, tzs, low, high)
                if len(box) > 2:
                    number = keep_inside(chosen, number, xs, ys, zs, *corner, box)
                if content >= 0:
                    number = weigh_scatterers(
                        chosen, number, xs, ys, zs, *corner,
                        content, cosine, sine, regions, lumens,
                    )  # fmt: skip
                deposit(accumulator, chosen, number, line, sample, cosine, sine, pulse)
