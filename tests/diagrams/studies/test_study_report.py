"""What a study leaves: JSON, pictures and a page that needs no other file."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sonoservo.diagrams.app.terminal import study_table
from sonoservo.diagrams.studies import Case, Outcome, Study, StudyFigure, StudyRow, write_study
from sonoservo.diagrams.studies.study_report import can_be_judged, figure_text


@pytest.fixture
def study():
    figure = Figure()
    figure.subplots().plot([0, 1])
    return Study(
        paper="someone2013",
        title="Someone, Needles & <probes>",
        rows=[
            StudyRow(
                experiment="fig4", quantity="tip error", unit="mm", true=0.61, target=0.7,
                paper=1.5, estimated=0.4, low=0.5, high=0.75, published_estimated=0.9,
                published_true=1.2, published_low=-float("inf"), published_high=float("inf"),
            ),
            StudyRow(experiment="fig4", quantity="found", true=18, target=20, wanted="at least"),
            StudyRow(experiment="fig5", quantity="unknown", unit="s"),
            StudyRow(experiment="fig5", quantity="error", true=float("inf"), target=1.0),
        ],
        outcomes=[
            Outcome(Case("fig4", 0), {"x": 1}, wall_s=2.0),
            Outcome(Case("fig4", 1), {"x": 2}, wall_s=3.0),
            Outcome(Case("fig4", 3), error="ValueError: <no> luck"),
        ],
        figures=[StudyFigure(name="errors", caption="Errors & co", figure=figure)],
        compute_ms={"track": {"median": 5.0, "max": float("nan")}},
        notes=["20 seeds < 100."],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, None),
        ({"true": 1.0}, None),
        ({"target": 1.0}, "not measured"),
        ({"target": 1.0, "true": 1.0}, "yes"),
        ({"target": 1.0, "true": 1.1, "estimated": 0.1}, "no"),
        ({"target": 1.0, "estimated": 0.9}, "yes"),
        ({"target": 1.0, "true": 1.1, "wanted": "at least"}, "yes"),
        ({"target": 1.0, "true": 0.9, "wanted": "at least"}, "no"),
        ({"target": 1.0, "true": 0.9, "low": 0.8, "high": 1.0}, "yes"),
        ({"target": 1.0, "true": 0.9, "low": 0.8, "high": 1.1}, "undecided"),
        ({"target": 1.0, "true": 0.9, "low": -np.inf, "high": np.inf}, "undecided"),
        ({"target": 1.0, "true": 1.2, "low": 1.0, "high": 1.3}, "no"),
        ({"target": 0, "true": 0, "low": 0.0, "high": 3.7}, "yes"),
    ],
)
def test_a_target_is_judged_by_the_truth(values, expected):
    assert StudyRow(experiment="e", quantity="q", **values).verdict == expected


@pytest.mark.parametrize(
    ("total", "target", "wanted", "judged"),
    [
        (0, 50, "at least", False),
        (6, 100, "at least", True),
        (6, 90, "at least", False),
        (100, 96, "at least", True),
        (30, 96, "at least", False),
        (100, 99, "at most", False),  # 96.4 to 100 % of 100
        (400, 99, "at most", True),
    ],
)
def test_a_target_of_a_share_needs_runs_that_can_meet_and_miss_it(total, target, wanted, judged):
    assert can_be_judged(total, target, wanted) is judged


@pytest.mark.parametrize(
    ("figure", "text"),
    [
        ((0.5, 0.4, np.inf), "0.500 (0.400 to ∞)"),
        ((0.5, -np.inf, np.inf), "0.500"),
        ((np.inf, np.inf, np.inf), "∞"),
        ((None, None, None), "–"),
        ((None, None, None, ""), ""),
    ],
)
def test_a_figure_has_the_interval_that_enough_runs_tell(figure, text):
    assert figure_text(*figure) == text


def test_json(study, tmp_path):
    returned = write_study(tmp_path, study, "sonoservo reproduce someone2013")
    data = json.loads((tmp_path / "study.json").read_text())
    assert data.keys() == returned.keys()
    assert data["paper"] == "someone2013"
    assert data["command"] == "sonoservo reproduce someone2013"
    assert data["version"]
    assert data["seeds"] == {"fig4": [0, 1, 3]}
    wanted = {"experiment", "quantity", "unit", "paper", "estimated", "true", "target", "verdict"}
    assert all(wanted <= row.keys() for row in data["rows"])
    assert [row["verdict"] for row in data["rows"]] == ["undecided", "no", None, "no"]
    assert data["rows"][-1]["true"] is None
    assert data["cases"] == {"fig4": {"cases": 3, "failed": 1}}
    (failure,) = data["failures"]
    assert (failure["seed"], failure["error"]) == (3, "ValueError: <no> luck")
    assert data["compute_ms"] == {"track": {"median": 5.0, "max": None}}


def test_page_needs_no_other_file(study, tmp_path):
    write_study(tmp_path, study, "sonoservo reproduce someone2013")
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "report.html").read_text()
    assert re.findall(r"(?:src|href)=\"([^\"]{0,20})", text) == ["data:image/png;base6"]
    assert "url(" not in text
    cells = [re.findall(r"<t[hd]>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>.*?</tr>", text)]
    assert [
        "fig4", "tip error (mm)", "1.50", "0.400", "0.610", "0.500 to 0.750", "0.900", "1.20",
        "too few runs", "≤ 0.7", "undecided",
    ] in cells  # fmt: skip

    assert ["", "found", "", "", "18", *4 * [""], "≥ 20", "<b>no</b>"] in cells
    assert ["", "error", "", "", "∞", *4 * [""], "≤ 1", "<b>no</b>"] in cells
    assert ["fig4", "0-1, 3", "3", "1"] in cells
    assert "ValueError: &lt;no&gt; luck" in text
    assert "0 of 3 targets met, 1 undecided" in text
    assert "20 seeds &lt; 100." in text


def _shown(study, width):
    console = Console(width=width)
    with console.capture() as capture:
        console.print(study_table(study, console.width))
    return " ".join(capture.get().split())


def test_a_narrow_terminal_shows_what_is_true_and_cuts_nothing_off(study):
    text = _shown(study, 80)
    assert "tip error (mm) 1.50 0.610 0.500 to 1.20 ≤ 0.7 undecided 0.750" in text
    assert "estimated" not in text
    assert "…" not in text


def test_a_column_in_which_nothing_stands_is_left_out(study):
    text = _shown(replace(study, rows=study.rows[1:]), 120)
    assert "paper" not in text
    assert "published" not in text
    assert "target" in text
