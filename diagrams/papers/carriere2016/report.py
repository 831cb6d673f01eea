"""Report of the reproduction of Carriere 2016: rows with targets, figures and notes."""

from collections.abc import Sequence
from typing import Any

from sonoservo.diagrams.papers.carriere2016.plots import (
    plot_departures,
    plot_error_against_depth,
    plot_errors,
    plot_particles,
    plot_paths,
    plot_slice,
    plot_sweeps,
)
from sonoservo.diagrams.papers.carriere2016.protocols import PROTOCOLS, SETS, SWEPT
from sonoservo.diagrams.papers.carriere2016.rows_report import PAPER, set_rows, sweep_rows
from sonoservo.diagrams.papers.carriere2016.runs import AS_PUBLISHED, BEVEL_MARK_DEG, TAUGHT
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyFigure

NAMES = {
    TAUGHT: "particle filter, wander learnt",
    "particle_filter": "particle filter",
    "least_squares": "least squares, constant curvature",
    AS_PUBLISHED: "as published",
}

NOTES = (
    "Errors are means over needles. 'Estimated' errors are against the measured path, as in the "
    "paper; 'true' errors are against the simulated needle. The tip error is |u - u^| at the last "
    "slice. The shape error is the integral of |u - u^| over depth (eq. 8), with u in the plane of "
    "largest deflection. Every prediction counts, whether or not the needle was followed to the "
    "end. A needle without a prediction has the row's worst error. A tip that was not found has no "
    "measured error; a row gives the share of these.",
    "The published method is that of the paper as a whole: the click is the first position, eq. 1 "
    "shows dark pixels like bright ones, the best match with the last template is the position, "
    "and the printed particle filter guides the region of interest. It sees the same slices and "
    "the same click as ours.",
    "The needles have R uniform between 0.8 and 2.4 m, theta_0 uniform within 2 deg, and any "
    "plane. All estimators assume R normal (1.5, 0.6 m) and theta_0 normal (0, 5 deg), as "
    "published. The tissue shifts by 0.1 mm (standard deviation) from slice to slice, in addition "
    "to the effects of speckle and fibres. A person's click on the first cross-section scatters by "
    "0.5 mm along each axis.",
    "Not published: the full depth (here 140 mm in beef, 60 mm in the patient), gamma (0.05), the "
    "template's size (6 x 6 mm) and the direction of u. Gamma was chosen for the printed filter's "
    "own errors, on needles of seeds from 100 on, among the values of the sweep; phi is found from "
    "all points so far. The filter as printed is given the bevel's "
    f"direction to within {BEVEL_MARK_DEG:.0f} deg; the other estimators are not.",
    "'Wander learnt' is our particle filter with a prior of the curvature's wander that ten whole "
    "needles in the same tissue taught it. Up to a rotation at 60 mm, the slices of one needle "
    "hardly show how much its curvature wanders, so without the ten needles the stated uncertainty "
    "rests on the default, 10 %.",
    "The bound is the Bayesian Cramer-Rao bound of the tip's root mean square error, with the "
    "information at the true path and the median scatter of the measured path. It knows the "
    "wander's amplitude. The departures from the model other than the wander are not in it.",
    "Departures from the model are on the first set's needles, and only the slices that the "
    "estimators use are made.",
    "Elastic needle: a beam on an elastic foundation that also cuts sideways, behind a template, "
    "with R uniform between 0.3 and 2.4 m. No estimator is derived from it, and the shaft moves "
    "after it was seen (BeamPath). The bound, which is the bicycle's, is left out.",
    "Computing time is the processor time of one thread.",
)


def report(outcomes: Sequence[Outcome], pictured: bool = False) -> Study:
    """Return the study of the runs of all experiments, with its figures on request."""
    rows = [
        row for name in PROTOCOLS if (mine := _of(outcomes, name)) for row in set_rows(name, mine)
    ]
    return Study(
        paper="carriere2016",
        title="Carriere, Rossa, Sloboda, Usmani, Tavakoli: Real-time needle shape prediction in "
        "soft-tissue based on image segmentation and particle filtering (AIM 2016)",
        rows=[*rows, *sweep_rows(_of(outcomes, SWEPT))],
        outcomes=outcomes,
        figures=_figures(outcomes) if pictured else (),
        compute_ms=_compute(outcomes),
        notes=NOTES,
    )


def _compute(outcomes: Sequence[Outcome]) -> dict[str, dict[str, float | None]]:
    """Return the largest median and the largest of all computing times of a needle."""
    times = [each.result["compute_ms"] for each in outcomes if each]
    return {
        part: {
            "median": max((each[part]["median"] or 0.0 for each in times), default=None),
            "max": max((each[part]["max"] or 0.0 for each in times), default=None),
        }
        for part in ("image", "estimate", "total")
    }


def _figures(outcomes: Sequence[Outcome]) -> list[StudyFigure]:
    every = {name: [each.result for each in _of(outcomes, name) if each] for name in PROTOCOLS}
    every = {name: each for name, each in every.items() if each}
    results = {name: each for name, each in every.items() if name in SETS}
    if not results:
        return []
    figures = [
        StudyFigure(
            name="paths",
            caption="Like figs. 8 and 9 of the paper: six needles of each set, measured and "
            "predicted path (particle filter). Dashed: last slice used.",
            figure=plot_paths(results),
        ),
        StudyFigure(
            name="error_against_depth",
            caption="Like fig. 7: error of the predicted tip against the depth observed; median "
            "and 90 % range of the needles, and median of the estimates' 95 % bounds.",
            figure=plot_error_against_depth(results, NAMES),
        ),
        StudyFigure(
            name="errors",
            caption="Tip and shape error against the true path, of all needles of each set.",
            figure=plot_errors(results, NAMES, PAPER),
        ),
        StudyFigure(
            name="departures",
            caption="Departures from the model: mean error of the predicted tip against the true "
            "one, and share of the tips within the stated 95 %, with 95 % intervals.",
            figure=plot_departures(every, NAMES),
        ),
    ]
    swept = [each for each in results.get(SWEPT, []) if each["sweeps"]]
    if swept:
        figures.append(
            StudyFigure(
                name="sweeps",
                caption="Published method with other values of the parameters that the paper does "
                "not give, and of n: true errors, mean and 95 % interval.",
                figure=plot_sweeps(swept),
            )
        )
    return figures + _kept_figures(results)


def _kept_figures(results: dict[str, list[Any]]) -> list[StudyFigure]:
    kept = {name: each[0] for name, each in results.items() if "slice" in each[0]}
    figures = [
        StudyFigure(
            name=f"slice_{name}",
            caption=f"Like figs. 2 and 3, {name}: first slice, and its variance image (eq. 1) with "
            "the template.",
            figure=plot_slice(result["slice"]),
        )
        for name, result in kept.items()
    ]
    for result in list(kept.values())[:1]:
        figures.append(
            StudyFigure(
                name="particles",
                caption="Like fig. 6: particles of one needle before the first slice, five slices "
                "after 10 mm, and at the end. The cross is the truth; the faint cross is the path "
                "that starts alike and bends to the other side.",
                figure=plot_particles(
                    result["particles"], result["truth"], {**NAMES, "published": "as printed"}
                ),
            )
        )
    return figures


def _of(outcomes: Sequence[Outcome], experiment: str) -> list[Outcome]:
    return [each for each in outcomes if each.case.experiment == experiment]
