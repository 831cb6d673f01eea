"""Lines of the study's volumes: their looks, and whether each is the needle."""

from dataclasses import dataclass

import numpy as np

from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_fit import fitted_lines
from sonoservo.systems.tracking.needle_line import SHORTEST, clutter, evident_stretches, lie_along

from .own_scans import drawn_scan
from .painted import painted


@dataclass
class Lines:
    """Lines of many volumes, a row each."""

    names: list[str]  # of the looks
    looks: np.ndarray  # (n, f)
    right: np.ndarray  # (n,) flags of those that are needles
    volume: np.ndarray  # (n,) numbers of their volumes
    made: np.ndarray  # (v, 3) generator (0 own, 1 painted), seed and whether there is a needle


def cases(generator, seed, needle):
    """Return a volume of a generator and the ends of its needle in P, each perhaps None."""
    if generator == "painted":
        made = painted(seed, needle)
        return made.volume, made.ends
    made = drawn_scan(seed, needle)
    if made is None:
        return None, None
    volume = made.volume.at_once()
    return volume, volume.to_probe(made.needle.control_points[[0, -1]]) if needle else None


GENERATORS = ("own", "painted")


def collect(seeds):
    """Return the `Lines` of the volumes of these seeds, with and without a needle."""
    names, looks, right, number, made = [], [], [], [], []
    for seed in seeds:
        for which, generator in enumerate(GENERATORS):
            for needle in (True, False):
                volume, ends = cases(generator, seed, needle)
                fits = fitted_lines(volume, cells_of(volume)) if volume else None
                if not fits:
                    continue
                found = evident_stretches(volume, np.array([fit.ends for fit in fits]))
                long = np.linalg.norm(found.ends[:, 1] - found.ends[:, 0], axis=1) >= SHORTEST
                features = found.looks(volume, clutter(fits))
                names = list(features)
                looks.append(np.stack(list(features.values()), axis=1)[long])
                along = np.zeros(long.sum(), bool)
                if needle:
                    along = lie_along(ends[np.newaxis], found.ends[long])[0]
                right.append(along)
                number.append(np.full(long.sum(), len(made)))
                made.append((which, seed, needle))
    return Lines(
        names, np.concatenate(looks), np.concatenate(right), np.concatenate(number), np.array(made)
    )
