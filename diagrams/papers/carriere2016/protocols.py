"""Experiments of the reproduction of Carriere 2016: needles, and departures from their model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

SETS = ("d60", "d80", "patient")
"""Sets of needles of the paper."""


@dataclass(frozen=True)
class Protocol:
    """Protocol of one experiment: name of the scenario, numbers of needles, changes.

    `whole`: whether the slices beyond the last one used are made, too, which the measured path
    needs; `learnt`: the `LESSONS` whose needles teach the amplitude of the wander; empty for none.
    """

    scenario: str
    seeds: int
    quick: int
    changes: Sequence[str] = ()
    whole: bool = False
    learnt: str = ""


def _departure(*changes: str, seeds: int = 20, learnt: str = "even") -> Protocol:
    return Protocol("carriere2016_d60", seeds, 1, changes, learnt=learnt)


_NOTHING = ""
"""A plane that drifts, or a turn that is some degrees off, is no wander of the whole path, so its
needles would teach too small an amplitude; the default holds."""

_WANDERS = (5, 10, 20, 30)

_ELASTIC = ("hand.mechanics=beam", "hand.bend_radius=1.35", "hand.bend_radius_spread=1.05")
"""Needles of another mechanics than the estimators', which are all derived from the bicycle."""

LESSONS: Mapping[str, Sequence[str]] = {
    "even": [],
    **{f"{each} %": [f"hand.curvature_wander={each / 100}"] for each in _WANDERS},
}
"""Changes of the scenario of the whole needles that teach the amplitude, by tissue."""

LESSON_SEEDS, QUICK_LESSON_SEEDS = range(900, 910), range(900, 902)
"""Seeds of these needles, none of which is reported."""

PROTOCOLS: Mapping[str, Protocol] = {
    "d60": Protocol("carriere2016_d60", 100, 2, whole=True, learnt="even"),
    "d80": Protocol("carriere2016_d80", 100, 2, whole=True, learnt="even"),
    "patient": Protocol("carriere2016_patient", 100, 4, whole=True),
    **{
        f"curvature wanders by {each} %": _departure(
            *LESSONS[f"{each} %"], seeds=50, learnt=f"{each} %"
        )
        for each in _WANDERS
    },
    "plane drifts by up to 30 deg in 0.1 m": _departure(
        "hand.bend_drift_spread_deg=30", learnt=_NOTHING
    ),
    "rotation off by up to 2 mm": _departure("hand.rotation_depth_spread=2e-3"),
    "rotation off by up to 10 deg": _departure(
        "hand.rotation_angle_spread_deg=10", learnt=_NOTHING
    ),
    "breathing of 0.5 mm": _departure("breathing=0.5e-3"),
    "3 in 10 slices dropped": _departure("scanner.connection.lost_sweeps=0.3"),
    **{
        f"{name}, elastic needle": Protocol(f"carriere2016_{name}", 20, 1, _ELASTIC, learnt="even")
        for name in SETS
    },
    "d80, radii of 1.2 to 1.8 m": Protocol(
        "carriere2016_d80",
        20,
        1,
        ("hand.bend_radius=1.5", "hand.bend_radius_spread=0.3"),
        learnt="even",
    ),
    "second needle beside": _departure("phantom=beef_two_needles"),
}
"""Protocol of each experiment, by name."""

SWEEPS: Mapping[str, Mapping[str, Sequence[str]]] = {
    "gamma": {f"{gain:g}": [f"published.gain={gain}"] for gain in (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)},
    "n": {f"{n}": [f"published.particles={n}"] for n in (50, 100, 500, 2000)},
    "template": {f"{h} mm": [f"tracker.template=[{h}e-3, {h}e-3]"] for h in (2, 3, 4, 6, 9)},
}
"""Changes of the published method by parameter and value; the published one is among them."""

SWEEP_SEEDS = 20
"""Number of the first needles of each set of the paper on which the parameters are swept."""
