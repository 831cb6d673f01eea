"""Needle shape prediction per slice: the paper's times, and template matching by others."""

import numpy as np
import pytest

from sonoservo.diagrams import estimate_shape, load_scenario, make_experiment
from sonoservo.systems.shape import CrossSectionParameters
from sonoservo.systems.shape.cross_section import find_again

PAPER_MS = {"image": 3.1, "particle filter": 2.8}


@pytest.fixture(scope="module")
def experiment():
    experiment = make_experiment(
        load_scenario("carriere2016_d60", changes=["depth=0.07"], seed=101)
    )
    slices = []
    experiment.run(lambda each: slices.append(each.evaluate(each.slice_converter, "slice")))
    return experiment, slices


def test_cross_section_in_a_slice(benchmark, experiment):
    experiment, slices = experiment
    last = experiment.cross_sections[100]
    number = int(np.argmin([abs(each.time - last.time) for each in slices]))
    parameters = CrossSectionParameters()
    expected = last.centre, parameters.expected_std
    found = benchmark(find_again, slices[number + 1], last, expected, parameters)
    assert found
    note_paper(benchmark, "image")


def test_particle_filter_per_slice(benchmark, experiment):
    experiment, _ = experiment
    used = experiment.cross_sections[:117]

    def whole():
        return estimate_shape(experiment.make_estimator("particle_filter"), used)

    shapes = benchmark.pedantic(whole, rounds=3, warmup_rounds=1)
    assert shapes[-1].observed > 0.055
    benchmark.extra_info["slices"] = len(used)
    note_paper(benchmark, "particle filter", len(used))


def note_paper(benchmark, part, slices=1):
    benchmark.extra_info["compared_with"] = "the paper's, on a Core i7-3930K in Matlab"
    if benchmark.stats is not None:
        ours = 1e3 * benchmark.stats["min"] / slices
        benchmark.extra_info["ms_per_slice"] = ours
        benchmark.extra_info["ratio"] = PAPER_MS[part] / ours
