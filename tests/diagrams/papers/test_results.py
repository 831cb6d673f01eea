"""Kept results, and the tables that show them."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from sonoservo.diagrams.papers import results
from sonoservo.diagrams.papers.repeats import choose_missing
from sonoservo.diagrams.studies import records
from sonoservo.diagrams.studies.fingerprint import made_by
from sonoservo.diagrams.studies.study import Case, Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow
from sonoservo.systems.files.refusals import ConfigurationError


@pytest.mark.parametrize("page", results.PAGES, ids=lambda page: page.name)
def test_pages_show_what_the_records_say_by_the_present_definitions(page):
    """If this fails, a definition has changed, code of the kept runs has, or the page was edited.

    `python -c "from sonoservo.diagrams.papers.results import write_tables; write_tables()"`
    """
    text = page.read_text(encoding="utf-8")
    assert results.with_tables(text) == text


@pytest.fixture
def study():
    return Study(
        paper="chatelain2013",
        title="Someone",
        rows=[
            StudyRow(
                experiment="fig5", quantity="at rest", unit="mm", paper=1.1, estimated=0.5,
                true=0.6, low=0.4, high=0.7, published_true=2.5, target=0.7,
            ),
            StudyRow(experiment="fig5", quantity="times lost", true=3, target=0),
        ],
        outcomes=[Outcome(Case("fig5", 0), {"x": 1 / 3}, made_by=made_by("my_study"))],
    )  # fmt: skip


@pytest.fixture
def data(study):
    return study.as_json("sonoservo reproduce all") | {"commit": "a", "outdated": False}


@pytest.fixture
def house(study, tmp_path, monkeypatch):
    """A house with one page and no results, in which a study's records make that study."""
    (tmp_path / "page.md").write_text(
        "a\n<!-- results chatelain2013 published -->\n<!-- end of results -->\nb\n"
    )
    (tmp_path / "diagrams" / "papers" / "chatelain2013").mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setattr(results, "_ROOT", tmp_path)
    monkeypatch.setattr(results, "PAGES", (tmp_path / "page.md",))
    monkeypatch.setattr(records, "present_commit", lambda: "abc")
    seen = []
    report = SimpleNamespace(report=lambda found: seen.append(found) or study)
    monkeypatch.setattr(results, "module_of", lambda *name: report)
    yield tmp_path, seen
    results._tables.cache_clear()


def test_records_are_kept_and_become_tables(study, house):
    folder, seen = house
    page = folder / "page.md"
    results.write_tables()
    assert "no results yet" in page.read_text()
    results.keep_records({"chatelain2013": study.outcomes}, "sonoservo reproduce all")
    text = page.read_text()
    assert (
        "Commit abc, `sonoservo reproduce all`, 1 seed an experiment: 1 of 2 targets met." in text
    )
    assert "| fig5: at rest (mm) | 1.10 | 0.500 | 0.600 (0.400 to 0.700) | 2.50 |" in text
    assert "times lost" not in text  # no figure of the paper
    assert text.startswith("a\n")
    assert text.endswith("-->\nb\n")
    ((outcome,),) = seen  # to six digits
    assert outcome == replace(study.outcomes[0], result={"x": 0.333333})


def test_only_records_of_the_present_committed_code_are_kept(study, house, monkeypatch):
    folder, _ = house
    other = {**made_by("my_study"), "sonoservo's code": "0"}
    late = replace(study, outcomes=[replace(study.outcomes[0], made_by=other)])
    with pytest.raises(ConfigurationError, match="other code than the present one"):
        results.keep_records({"chatelain2013": late.outcomes}, "")
    monkeypatch.setattr(records, "present_commit", lambda: "abc+")
    with pytest.raises(ConfigurationError, match="not committed"):
        results.keep_records({"chatelain2013": study.outcomes}, "")
    (folder / "pyproject.toml").unlink()
    with pytest.raises(ConfigurationError, match="in a checkout"):
        results.keep_records({"chatelain2013": study.outcomes}, "")


def test_runs_of_the_same_code_join_those_that_are_kept(study, house, monkeypatch):
    (first,) = study.outcomes
    first = replace(first, case=replace(first.case, settings={"bend": 1 / 3}))
    second = replace(first, case=replace(first.case, seed=1))
    with pytest.raises(ConfigurationError, match="no records of runs are kept of chatelain2013"):
        results.require_addable("chatelain2013")
    results.keep_records({"chatelain2013": [first]}, "one")
    choose = choose_missing("chatelain2013")
    assert choose([first.case, second.case]) == [second.case]
    with pytest.raises(ConfigurationError, match="kept already"):
        choose([first.case])
    for command in ("two", "three"):
        results.keep_records({"chatelain2013": [second, first]}, command, adds="part")
    kept = results.kept_records("chatelain2013")
    assert [each.case.seed for each in kept.outcomes] == [0, 1]
    assert kept.command == "one; two; three"
    results.keep_records({"chatelain2013": [second]}, "all", adds="rest")
    assert results.kept_records("chatelain2013").command == "all"
    monkeypatch.setattr(records, "is_outdated", lambda identity: True)  # the code has changed
    with pytest.raises(ConfigurationError, match="other code than the present one"):
        results.require_addable("chatelain2013")
    results.keep_repeat("chatelain2013", 1)  # but makes the same
    assert len(results.require_addable("chatelain2013").outcomes) == 2


def test_each_experiment_has_a_line_of_its_main_figures(data):
    row = data["rows"][0] | {"true": 50.0, "low": 20.0, "high": None, "published_true": None}
    published = {"published_true": 0.0, "published_low": 0.0, "published_high": 40.0}
    rows = [
        row | {"quantity": "success", **published},
        row | {"quantity": "success, zhao2012", "true": 25.0, "low": None},
        row | {"quantity": "axis error, median"},
        row | {"experiment": "success falls under 95 % at"},
    ]
    lines = results.results_table(data | {"rows": rows}, "experiments").splitlines()[2:]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    line = dict(zip(cells[0], cells[2], strict=True))
    assert len(cells) == 3
    assert {head: cell for head, cell in line.items() if cell} == {
        "experiment": "fig5",
        "seeds": "1",
        "success (%)": "50.0 (20.0 to ∞)",
        "success, as published (%)": "0 (0 to 40.0)",
        "success, zhao2012 (%)": "25.0",
    }


def test_where_the_published_method_is_better_stands_before_the_tables(study, data):
    assert data["published_better"] == ""
    (worse,) = study.rows[:1]
    better = replace(worse, published_true=0.2, published_low=0.1, published_high=0.3)
    other_side = replace(better, wanted="at least", quantity="share")
    said = replace(study, rows=[better, other_side]).as_json("")["published_better"]
    assert said == "The published method is better in fig5: at rest (mm)."
    assert said in results.results_table(data | {"published_better": said}, "all")


def test_a_repeat_of_some_runs_says_that_other_code_gives_the_same_figures(
    study, house, monkeypatch
):
    page = house[0] / "page.md"
    results.keep_records({"chatelain2013": study.outcomes}, "sonoservo reproduce all")
    monkeypatch.setattr(records, "is_outdated", lambda identity: True)  # the code has changed
    results._tables.cache_clear()
    assert results.CHANGED in results.with_tables(page.read_text())
    monkeypatch.setattr(records, "present_commit", lambda: "def")
    for _ in range(2):
        results.keep_repeat("chatelain2013", 20)
    again = " 20 of the runs, made again by commit def ("
    assert page.read_text().count(again) == 1
    assert results.CHANGED not in page.read_text()
    (kept,) = study.outcomes
    identity = {"module": "m", "sonoservo's code": "changed"}
    anew = replace(kept, case=replace(kept.case, seed=1), made_by=identity)
    monkeypatch.setattr(results, "is_outdated", lambda made_by: made_by != identity)
    monkeypatch.setattr(records, "code_fingerprint", lambda module: "changed")
    results.keep_refreshed("chatelain2013", [anew], 3, whole=False)
    assert results.CHANGED in page.read_text()  # there may be more
    results.keep_refreshed("chatelain2013", [anew], 3, whole=True)
    assert " as their figures had changed: 1 by def." in page.read_text()
    assert " 3 of the runs, made again by commit def" in page.read_text()
    monkeypatch.setattr(records, "code_fingerprint", lambda module: "changed once more")
    results._tables.cache_clear()
    text = results.with_tables(page.read_text())
    assert results.CHANGED in text
    assert again not in text
    monkeypatch.setattr(records, "present_commit", lambda: "def+")
    with pytest.raises(ConfigurationError, match="not committed"):
        results.keep_repeat("chatelain2013", 20)
    (house[0] / "pyproject.toml").unlink()
    with pytest.raises(ConfigurationError, match="in a checkout"):
        results.keep_repeat("chatelain2013", 20)
