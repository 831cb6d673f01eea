"""Compiled kernels: cells of a volume, contrast along lines, fits of lines, and their belief."""

import math
from typing import Any

import numpy as np
from numba import njit

from sonoservo.systems.sampling.interpolation import trilinear

KERNEL = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**KERNEL)
def line_contrasts(  # pragma: no cover - compiled
    intensities: Any, starts: Any, steps: Any, across: Any, core: float, ring: float,
    average: int, count: int,
) -> Any:  # fmt: skip
    """Return the contrasts of lines with what lies beside them, and where they are seen.

    Parameters
    ----------
    intensities
        Grey levels; 0 outside the field of view.
    starts, steps
        (n, 3) fractional indices of each line's first bin, and differences between its bins.
    across
        (n, 2, 3) differences of index for 1 m along two directions across each line.
    core, ring
        Radii of the line's core and of the ring beside it, in m.
    average
        Number of bins to either side over which the ring's sectors are averaged.
    count
        Number of bins.

    Returns
    -------
    (n, count) grey levels of the core above the second brightest of eight sectors of the ring, and
    (n, count) flags of the bins that are seen.
    """
    nx, ny, nz = intensities.shape
    contrasts = np.zeros((len(starts), count), np.float32)
    seen = np.zeros((len(starts), count), np.bool_)
    inner, sides = np.zeros(count), np.zeros((count, 8))
    valid = np.zeros((count, 8), np.int64)
    offsets = np.zeros((8, 3))
    for n in range(len(starts)):
        u, w = across[n]
        for s in range(8):
            c, d = ring * math.cos(s * math.pi / 4), ring * math.sin(s * math.pi / 4)
            offsets[s] = c * u + d * w
        for b in range(count):
            seen[n, b] = True
            inner[b] = 0.0
            for half in range(2):
                at = starts[n] + (b + 0.5 * half - 0.25) * steps[n]
                x, y, z = at[0], at[1], at[2]
                if not (1 <= x <= nx - 2 and 1 <= y <= ny - 2 and 1 <= z <= nz - 2):
                    seen[n, b] = False
                    break
                level = trilinear(intensities, x, y, z)
                if level <= 0:
                    seen[n, b] = False
                    break
                for q in range(4):
                    c = core * (1 - 2 * (q % 2))
                    v = u if q < 2 else w
                    level += trilinear(intensities, x + c * v[0], y + c * v[1], z + c * v[2])
                inner[b] += 0.1 * level
            for s in range(8):
                valid[b, s] = 0
                sides[b, s] = 0.0
                if seen[n, b]:
                    at = starts[n] + b * steps[n] + offsets[s]
                    x, y, z = at[0], at[1], at[2]
                    if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
                        level = trilinear(intensities, x, y, z)
                        if level > 0:
                            sides[b, s], valid[b, s] = level, 1
        for b in range(count):
            if seen[n, b]:
                first, last = max(b - average, 0), min(b + average + 1, count)
                brightest, second = -1.0, -1.0
                for s in range(8):
                    total, number = 0.0, 0
                    for e in range(first, last):
                        total += sides[e, s]
                        number += valid[e, s]
                    if 2 * number > last - first:
                        total /= number
                        if total > brightest:
                            brightest, second = total, brightest
                        elif total > second:
                            second = total
                contrasts[n, b] = inner[b] - second
    return contrasts, seen


@njit(**KERNEL)
def _mean_level(intensities: Any, start: Any, stop: Any, count: int) -> float:  # pragma: no cover
    """Return the mean grey level between two fractional indices; 0 if less than half is seen."""
    nx, ny, nz = intensities.shape
    total, number = 0.0, 0
    for s in range(count):
        f = (s + 0.5) / count
        x = start[0] + f * (stop[0] - start[0])
        y = start[1] + f * (stop[1] - start[1])
        z = start[2] + f * (stop[2] - start[2])
        if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
            level = trilinear(intensities, x, y, z)
            if level > 0:
                total += level
                number += 1
    return total / number if 2 * number > count else 0.0


@njit(**KERNEL)
def fit_line(  # pragma: no cover - compiled
    intensities: Any, start: Any, stop: Any, u: Any, w: Any, count: int, reach: float, steps: Any
) -> Any:
    """Return the displacements of a line's ends across it that make it brightest.

    Parameters
    ----------
    intensities
        Grey levels; 0 outside the field of view.
    start, stop
        (3,) fractional indices of the ends.
    u, w
        (3,) differences of index for 1 m across the line.
    count
        Number of samples along the line.
    reach
        Largest displacement, in m.
    steps
        Displacements that are tried, coarse ones first, in m.

    Returns
    -------
    (4,) displacements of the start and of the stop along u and w, in m.
    """
    best, moved = -1.0, np.zeros(4)
    for number in range(len(steps)):
        step, far = steps[number], 2 if number == 0 else 1
        for turn in range(4):
            # The ends are moved alike and in opposite directions in turn.
            sense = 1.0 if turn % 2 == 0 else -1.0
            before = moved.copy()
            for i in range(-far, far + 1):
                for j in range(-far, far + 1):
                    tried = before + step * np.array([i, j, sense * i, sense * j])
                    if np.abs(tried).max() > reach:
                        continue
                    level = _mean_level(
                        intensities, start + tried[0] * u + tried[1] * w,
                        stop + tried[2] * u + tried[3] * w, count,
                    )  # fmt: skip
                    if level > best + 1e-6:
                        best = level
                        moved[:] = tried
    return moved


@njit(**KERNEL)
def best_stretch(evidence: Any) -> Any:  # pragma: no cover - compiled
    """Return the first and last index of the stretch with the largest sum (Kadane), and its sum."""
    first, last, best = 0, -1, 0.0
    start, total = 0, 0.0
    for i in range(len(evidence)):
        if total <= 0:
            start, total = i, 0.0
        total += evidence[i]
        if total > best:
            first, last, best = start, i, total
    return first, last, best


@njit(**KERNEL)
def add_volume(  # pragma: no cover - compiled
    shown: Any, logs: Any, ratios: Any, seen: Any, renewed: float, temper: float, prior: float
) -> None:
    """Add a volume to what is known of when each bin of each line arrived.

    Parameters
    ----------
    shown
        (n, t, b) probabilities that a bin which arrived at one of t times shows itself; changed.
    logs
        (n, t, b) log ratios of all contrasts since then, there against not there; changed.
    ratios, seen
        (n, b) log ratios of the volume's contrasts, shown against nothing, and flags of the bins
        that are seen.
    renewed
        Share of what shows itself that is drawn anew since the last volume.
    temper
        Share of the volume that is new evidence.
    prior
        Probability that a bin that is there shows itself.
    """
    for n in range(len(ratios)):
        for b in range(ratios.shape[1]):
            if not seen[n, b]:
                continue
            factor = math.exp(temper * ratios[n, b])
            for t in range(shown.shape[1]):
                p = shown[n, t, b]
                p += renewed * (prior - p)
                total = p * factor + 1 - p
                logs[n, t, b] += math.log(total)
                shown[n, t, b] = p * factor / total


@njit(**KERNEL)
def _stretches(factors: Any, begin: float, end: float) -> Any:  # pragma: no cover - compiled
    """Return (b + 1,) logs of what rests before each bin: all stretches there, against none."""
    absent, present = 1 - begin, begin
    result = np.zeros(len(factors) + 1)
    for b in range(len(factors)):
        if b > 0:
            absent, present = (
                absent * (1 - begin) + present * end, absent * begin + present * (1 - end)
            )  # fmt: skip
        present *= factors[b]
        norm = absent + present
        absent /= norm
        present /= norm
        result[b + 1] = result[b] + math.log(norm)
    return result


@njit(**KERNEL)
def _advancing(  # pragma: no cover - compiled
    factors: Any, before: Any, beyond: Any, first: Any, advances: Any, keeps: float
) -> float:
    """Return the log of the summed probability of all needles that advance along a line.

    Parameters
    ----------
    factors
        (t, b) likelihood ratios of each bin, if it arrived at each time.
    before, beyond
        (b + 1,) logs of what rests on either side of each place of the tip.
    first
        (b + 1,) prior probabilities of the tip's first place.
    advances
        (m, d) probabilities of the number of bins that the tip passes between volumes, at each
        speed; the first one is rest.
    keeps
        Probability that a speed lasts from one volume to the next.
    """
    times, bins = factors.shape
    modes, most = advances.shape
    top = before.max()
    tip, mixed = np.zeros((modes, bins + 1)), np.zeros((modes, bins + 1))
    for a in range(bins + 1):
        one = first[a] * math.exp(before[a] - top)
        for m in range(modes):
            tip[m, a] = one * (0.5 if m == 0 else 0.5 / (modes - 1))
    result = top
    reached = np.zeros(most)
    for t in range(1, times):
        for a in range(bins + 1):
            moving = 0.0
            for m in range(1, modes):
                moving += tip[m, a]
            mixed[0, a] = keeps * tip[0, a] + 0.6 * (1 - keeps) * moving
            for m in range(1, modes):
                others = (moving - tip[m, a]) / max(modes - 2, 1)
                mixed[m, a] = keeps * tip[m, a] + (1 - keeps) * (
                    tip[0, a] / (modes - 1) + 0.4 * others
                )
        tip[:] = 0
        total = 0.0
        for a in range(bins + 1):
            reached[0] = 1.0
            for d in range(1, most):
                reached[d] = reached[d - 1] * factors[t, a + d - 1] if a + d <= bins else 0.0
            for m in range(modes):
                weight = mixed[m, a]
                if weight > 1e-12:
                    for d in range(most):
                        if a + d <= bins:
                            one = weight * advances[m, d] * reached[d]
                            tip[m, a + d] += one
                            total += one
        if total <= 0:
            return -1e3
        tip /= total
        result += math.log(total)
    last = beyond.max()
    total = 0.0
    for a in range(bins + 1):
        total += tip[:, a].sum() * math.exp(beyond[a] - last)
    return result + last + math.log(max(total, 1e-300))


@njit(**KERNEL)
def class_logs(  # pragma: no cover - compiled
    logs: Any, riding: Any, appearing: Any, share: float, advances: Any, keeps: float,
    entering: float, begin: float, end: float, least: float,
) -> Any:  # fmt: skip
    """Return (n, 5) log evidence of each line: needle either way, resting, riding, appeared.

    Parameters
    ----------
    logs
        (n, t, b) log ratios by time of arrival; see `add_volume`. The first is "always".
    riding
        (n, b) log ratios of a line that keeps its place in the image.
    appearing
        (t,) prior logarithms of the probability that something appears at each time.
    share
        Share of a bin's evidence that its neighbours do not give as well.
    advances, keeps
        See `_advancing`.
    entering
        Prior probability that a needle's tip came into view at the line's outer end.
    begin, end
        Probabilities that something bright begins and ends from one bin to the next.
    least
        Log evidence below the others' at which a needle is not looked into.
    """
    count, times, bins = logs.shape
    result = np.full((count, 5), -1e3)
    factors, turned = np.zeros((times, bins)), np.zeros((times, bins))
    before, beyond = np.zeros(bins + 1), np.zeros(bins + 1)
    first = np.zeros(bins + 1)
    for n in range(count):
        bound = 0.0
        for b in range(bins):
            highest = 0.0
            for t in range(times):
                one = min(share * logs[n, t, b], 20.0)
                highest = max(highest, one)
                factors[t, b] = math.exp(one)
                turned[t, bins - 1 - b] = factors[t, b]
            bound += highest
        before[:] = _stretches(factors[0], begin, end)
        back = _stretches(turned[0], begin, end)
        result[n, 2] = before[bins]
        result[n, 3] = _stretches(np.exp(share * riding[n]), begin, end)[bins]
        for t in range(1, times):
            one = _stretches(factors[t], begin, end)[bins] + appearing[t]
            a, c = max(result[n, 4], one), min(result[n, 4], one)
            result[n, 4] = a + math.log1p(math.exp(c - a))
        if bound < result[n, 2:].max() + least:
            continue
        for way in range(2):
            seen = 0
            one = factors if way == 0 else turned
            for b in range(bins):
                if one[0, b] != 1.0:
                    seen = b
                    break
            first[:] = (1 - entering) / (bins + 1)
            first[seen] += entering
            if way == 0:
                beyond[:] = back[::-1]
                result[n, 0] = _advancing(one, before, beyond, first, advances, keeps)
            else:
                beyond[:] = before[::-1]
                result[n, 1] = _advancing(one, back, beyond, first, advances, keeps)
    return result
