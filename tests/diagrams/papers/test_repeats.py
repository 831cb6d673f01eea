"""Kept runs made again: which are chosen, and what counts as another figure."""

import time
from types import SimpleNamespace

import pytest

from sonoservo.diagrams.papers import repeats, results
from sonoservo.diagrams.studies import Case, Outcome, StudyOptions
from sonoservo.diagrams.studies.processes import Processes
from sonoservo.diagrams.studies.records import Records
from sonoservo.diagrams.studies.runs import run_study
from sonoservo.systems.files.refusals import ConfigurationError


def teach(case):
    return {"learnt": case.seed / 3}


def work(case):
    tips = [case.seed / 7, None, case.settings["learnt"]]
    return {"tips": tips, "compute": {"track": time.perf_counter()}}


def run(options):
    """A study of two steps, of which only the second is kept."""
    lessons = run_study(teach, [Case("lesson", 7)], options, folder="lessons")
    settings = {"learnt": lessons[0].result["learnt"]}
    names = ("plain", "steep")
    return run_study(work, [Case(n, seed, settings) for n in names for seed in range(10)], options)


def kept(changed=None, learnt=2.33333):
    """Records of all runs, to six digits, with one more of an experiment that is gone."""
    cases = [Case(n, seed, {"learnt": learnt}) for n in ("plain", "steep") for seed in range(10)]
    outcomes = []
    for case in cases:
        tips = [float(f"{case.seed / 7:.6g}"), None, learnt]
        if case.name == changed:
            tips[0] += 1e-5
        outcomes.append(Outcome(case, {"tips": tips, "compute": {"track": 0.0}}))
    return Records("", "abc", "", [*outcomes, Outcome(Case("gone", 0), {"tips": [0.0]})])


@pytest.fixture
def repeat(tmp_path, monkeypatch):
    monkeypatch.setattr(repeats, "module_of", lambda *name: SimpleNamespace(run=run))

    def make(records, number):
        monkeypatch.setattr(results, "kept_records", lambda paper: records)
        options = StudyOptions(folder=tmp_path / str(number), cluster=Processes(1))
        return repeats.repeat_kept_runs("mine", number, options)

    make.options = StudyOptions(folder=tmp_path / "refreshed", cluster=Processes(1))
    return make


def test_some_runs_of_all_experiments_are_made_again_and_times_do_not_count(repeat):
    found = repeat(kept(), 8)
    assert len({each.name for each in found}) == len(found) == 8
    assert {each.name.split("_")[0] for each in found} == {"plain", "steep"}
    assert not any(each.difference for each in found)


def test_runs_of_one_experiment_and_seed_are_told_apart_by_their_settings(repeat, monkeypatch):
    cases = [Case("plain", 0, {"learnt": learnt}) for learnt in (1.0, 2.0, 3.0)]
    study = SimpleNamespace(run=lambda options: run_study(work, cases, options))
    monkeypatch.setattr(repeats, "module_of", lambda *name: study)
    outcomes = [Outcome(case, {"tips": [0.0, None, case.settings["learnt"]]}) for case in cases]
    found = repeat(Records("", "abc", "", outcomes), 3)
    assert {each.name for each in found} == {case.name for case in cases}
    assert not any(each.difference for each in found)


def test_another_figure_is_named_with_both_values(repeat):
    changed = Case("steep", 3, {"learnt": 2.33333}).name
    found = repeat(kept(changed), 21)
    assert len(found) == 20
    (other,) = [each for each in found if each.difference]
    assert other.name.startswith("steep_seed003")
    assert other.difference == "result.tips[0]: 0.428571, kept 0.428581"


def test_experiments_whose_figures_changed_are_made_again_and_others_are_not(repeat, monkeypatch):
    records = kept()

    def found():
        return repeats.refresh_kept_runs("mine", repeat.options)

    monkeypatch.setattr(results, "kept_records", lambda paper: records)
    monkeypatch.setattr(repeats, "is_outdated", lambda made_by: False)
    assert found() == repeats.Refreshed([], 0)
    monkeypatch.setattr(repeats, "is_outdated", lambda made_by: True)
    assert found() == repeats.Refreshed([], 6)
    for outcome in records.outcomes:
        if outcome.case.experiment == "steep":
            outcome.result["tips"][1] = 0.0
    refreshed = found()
    assert refreshed.same == 3
    assert {each.case.experiment for each in refreshed.outcomes} == {"steep"}
    assert sorted(each.case.seed for each in refreshed.outcomes) == list(range(10))
    assert all(each.result["tips"][1] is None for each in refreshed.outcomes)


def test_runs_that_the_study_does_not_make_any_more_are_refused(repeat):
    with pytest.raises(ConfigurationError, match="makes none of the kept runs"):
        repeat(kept(learnt=1.0), 5)
    with pytest.raises(ConfigurationError, match="no records"):
        repeat(None, 5)
