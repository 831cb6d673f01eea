"""Kept results, and the tables that show them."""

import re
from importlib.metadata import version

import pytest

from sonoservo.diagrams.papers import results
from sonoservo.diagrams.papers.registry import PAPERS, STUDIES
from sonoservo.diagrams.studies.fingerprint import study_fingerprint
from sonoservo.diagrams.studies.study import Case, Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow
from sonoservo.systems.files.refusals import ConfigurationError


@pytest.mark.parametrize("page", results.PAGES, ids=lambda page: page.name)
def test_pages_show_what_was_kept_and_nothing_else(page):
    """If this fails, code that makes results has changed, or the page was edited.

    `python -c "from sonoservo.diagrams.papers.results import write_tables; write_tables()"`
    """
    text = page.read_text(encoding="utf-8")
    tables = results.with_tables(text)
    if any(results.kept_results(each)["drake"] != version("drake") for each in (*PAPERS, *STUDIES)):
        # With another Drake, nobody can tell whether the code has changed.
        text, tables = text.replace(results.CHANGED, ""), tables.replace(results.CHANGED, "")
    assert tables == text


def test_every_paper_has_its_table():
    text = results.PAGES[1].read_text(encoding="utf-8")
    assert all(f"<!-- results {paper} all -->" in text for paper in PAPERS)


@pytest.fixture
def data():
    study = Study(
        paper="chatelain2013",
        title="Someone",
        rows=[
            StudyRow(
                experiment="fig5", quantity="at rest", unit="mm", paper=1.1, estimated=0.5,
                true=0.6, low=0.4, high=0.7, published_true=2.5, target=0.7,
            ),
            StudyRow(experiment="fig5", quantity="times lost", true=3, target=0),
        ],
        outcomes=[Outcome(Case("fig5", 0), {"x": 1})],
    )  # fmt: skip
    return study.as_json("sonoservo reproduce all") | {"commit": "a"}


def test_kept_results_become_tables(data, tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- results chatelain2013 published -->\n<!-- end of results -->\nb\n")
    (tmp_path / "chatelain2013").mkdir()
    monkeypatch.setattr(results, "_folder", tmp_path.joinpath)
    monkeypatch.setattr(results, "PAGES", (page,))
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setattr(results, "_ROOT", tmp_path)
    results.write_tables()
    assert "no results yet" in page.read_text()
    results.keep_results({"chatelain2013": data})
    text = page.read_text()
    assert "1 of 2 targets met" in text
    assert "| fig5 | at rest (mm) | 1.10 | 0.500 | 0.600 | 0.400 to 0.700 |" in text
    assert "times lost" not in text  # no figure of the paper
    assert "| | times lost |" in results.results_table(data, "all").replace("|  |", "| |")
    assert text.startswith("a\n")
    assert text.endswith("-->\nb\n")


def test_bars_stay_in_their_cells(data):
    data["rows"][0]["quantity"] = "mean |X|"
    for line in results.results_table(data, "all").splitlines()[2:]:
        assert len(re.split(r"(?<!\\)\|", line)) == 13
    assert r"mean \|X\|" in results.results_table(data, "all")


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


def test_each_main_figure_is_a_quantity_of_the_study():
    quantities = {row["quantity"] for row in results.kept_results("robustness")["rows"]}
    assert {quantity for quantity, _ in results._MAIN_FIGURES.values()} <= quantities


def test_only_results_of_one_commit_and_the_present_code_are_kept(data, tmp_path, monkeypatch):
    monkeypatch.setattr(results, "_ROOT", tmp_path)
    with pytest.raises(ConfigurationError, match="in a checkout"):
        results.keep_results({"chatelain2013": data})
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setattr(results, "_folder", (tmp_path / "nowhere").joinpath)
    for other, message in (({"commit": "b"}, "2 commits"), ({"fingerprint": "0"}, "other code")):
        with pytest.raises(ConfigurationError, match=message):
            results.keep_results({"chatelain2013": data, "zhao2012": data | other})
    with pytest.raises(ConfigurationError, match="not committed"):
        results.keep_results({"chatelain2013": data | {"commit": data["commit"] + "+"}})


def test_a_table_says_whether_its_code_has_changed(data):
    assert data["fingerprint"] == study_fingerprint("chatelain2013")
    said = "has changed since"
    for rows, more in (("all", {}), ("thresholds", {"thresholds": [{"dial": "speed"}]})):
        assert said not in results.results_table(data | more, rows)
        assert said in results.results_table(data | more | {"fingerprint": "0"}, rows)
        other_drake = {"fingerprint": "0", "drake": "0"}
        assert said not in results.results_table(data | more | other_drake, rows)
