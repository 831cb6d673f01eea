"""Errors of our localizer along the needle, and the least possible ones."""

import itertools

import numpy as np

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.tracking import NeedleLocalizerParameters, localize
from tip_study.bound import tip_error_bound

from .needles import CONTRASTS, DEPTHS, DIPS, TIPS, End, end_of, scanner, sweep_with
from .tables import line_of

NOISE_DB = -55.0


def error_along(end, using, seed):
    """Error of the localizer's tip along the needle in m, of one volume; NaN if there is none."""
    sweep, ends, rng = sweep_with(end, using, seed)
    volume = using.conversion(sweep)
    # A prediction that is 2 mm off in every direction; the localizer sees nothing else.
    expected = ends + rng.normal(0, 2e-3, (2, 3))
    prediction = NeedlePrediction(
        2, volume.time, NeedleCurve(expected), np.zeros((2, 3)), 4e-6 * np.eye(6), expected[0]
    )
    found = localize(volume, prediction, NeedleLocalizerParameters(), rng)
    k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return (found.curve.tip - ends[1]) @ k if found else np.nan


def noise_db(end, using):
    """Level of the noise over the tissue's at the tip."""
    return NOISE_DB + 2 * 0.5 * 1e-6 * using.imaging.transmit_frequency * 1e2 * end.depth


def bound_of(end, using, volumes):
    """Return the bound for a needle's end in the scanner's image."""
    return tip_error_bound(
        end_of(end, using), using.geometry, using.spread, depth=end.depth, dip_deg=end.dip,
        noise_db=noise_db(end, using), volumes=volumes, particles=100,
    )  # fmt: skip


def study(volumes, first_seed, say, *, bound_volumes=20, dips=DIPS, depths=DEPTHS, tips=TIPS,
          contrasts=CONTRASTS):  # fmt: skip
    """Say a line for each kind of end, and return {end: (errors of our tips in m, bound)}."""
    using, rows = scanner(), {}
    for each in itertools.product(dips, depths, tips, contrasts):
        end = End(*each)
        errors = np.array([error_along(end, using, first_seed + i) for i in range(volumes)])
        bound = bound_of(end, using, bound_volumes)
        rows[end] = errors, bound
        say(line_of(end, errors, bound))
    return rows
