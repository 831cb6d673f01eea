import base64
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from sonoservo.systems.evaluation import plot_errors, plot_run, summarize
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.report import Change, Story, report_page
from sonoservo.systems.evaluation.reports.verdict import following_verdict


def read_page(text):
    """The cells of every row of a page, and its links; raises if tags do not match."""
    closed = re.sub("<((?:meta|img)[^>]*)>", r"<\1/>", text.replace("<details open>", "<details>"))
    root = ElementTree.fromstring(closed.removeprefix("<!DOCTYPE html>"))
    rows = [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]
    return rows, [link.get("href") for link in root.iter("a")]


def test_plots_show_the_columns(insertion_log, make_log):
    feature, *_ = plot_run(insertion_log).axes
    lines = {line.get_label(): line for line in feature.get_lines()}
    x = lines["x"].get_ydata()
    inside = insertion_log.inserted_length > 0
    np.testing.assert_allclose(x[inside], 1e3 * (insertion_log.inserted_length[inside] - 0.05))
    assert np.isnan(x[~inside]).all()
    tip, axis, _ = plot_errors(insertion_log).axes
    assert np.nanmax(tip.get_lines()[0].get_ydata()) == pytest.approx(0.5)
    assert np.nanmax(axis.get_lines()[0].get_ydata()) == pytest.approx(0, abs=1e-6)
    for plot in (plot_run, plot_errors):
        assert png(plot(make_log(0, 0)), dpi=20).startswith(b"\x89PNG")


def test_page(insertion_log, make_log):
    picture = png(plot_errors(insertion_log), dpi=20)
    summary = {"scenario": "fig <5>", "seed": 3, "compile_s": 27.2, **summarize(insertion_log)}
    text = report_page(
        summary,
        {"Errors & co": picture},
        story=Story(
            verdict=following_verdict(summary),
            scenario=["A needle <18 gauge> is pushed in."],
            base="the scenario fig5",
            changes=[Change(path="imaging.gain", meaning="Gain", before="0.42", after="0.5")],
            command="sonoservo run fig5",
            links={"replay.html": "Watch the replay"},
        ),
        key_frames={"At 4.0 s": picture},
        paper={"servo.at_rest.x_mm": 1.1, "force.mean_n": 2.0},
    )
    rows, links = read_page(text)
    assert "<h1>fig &lt;5&gt;</h1>" in text
    assert "seed 3 · compiling kernels took 27 s more, which no figure counts" in text
    assert "<strong>The needle was found and followed.</strong> It was found" in text
    assert "95\u00a0% less than" in text
    assert "A needle &lt;18 gauge&gt; is pushed in." in text
    assert "sonoservo run fig5" in text
    assert links == ["replay.html"]
    assert ["Gain", "imaging.gain", "0.42", "0.5"] in rows
    assert ["tip error, median, mm", "0.500"] in rows
    assert ["at rest: mean |X|, true, mm", "0", "1.10"] in rows
    (mean,) = (row for row in rows if row[0] == "contact force, mean, N")
    assert mean[2] == "2.00"
    assert not [row[0] for row in rows if "_" in row[0]]  # no raw keys
    nothing, _ = read_page(report_page(summarize(make_log(0, 0)), {}))
    shown = " ".join(row[0] for row in nothing)
    assert "at detection" not in shown
    assert "since then" not in shown
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", text)
    assert [base64.b64decode(data) for data in pictures] == 2 * [picture]
