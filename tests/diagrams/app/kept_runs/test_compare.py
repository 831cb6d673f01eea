import json
from dataclasses import replace

import numpy as np
import pytest
from commands import sonoservo_here
from rich.console import Console
from synthetic_logs import build_insertion_log

from sonoservo.diagrams import compare, load_scenario
from sonoservo.systems.evaluation import summarize
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically, write_json


@pytest.fixture
def keep(tmp_path):
    """Write the folder of a run without simulating it."""

    def keep(name, shift=0.0, scenario="chatelain2013_fig5", **changes):
        log = build_insertion_log()
        log = replace(log, volume_estimate_tip=log.volume_estimate_tip + np.array([shift, 0, 0]))
        loaded = load_scenario(scenario, changes=changes)
        write_atomically(tmp_path / name / "scenario.yaml", loaded.to_yaml())
        write_log(tmp_path / name / "log.npz", log)
        write_json(tmp_path / name / "summary.json", {"real_time_factor": 3.0, **summarize(log)})
        return tmp_path / name

    return keep


def test_figures_stand_side_by_side_with_what_was_changed(keep, tmp_path):
    folders = [keep("a"), keep("b", 1e-3, **{"imaging.gain": 0.5}), keep("c", 0.0, seed=4)]
    comparison = compare(folders, out=tmp_path / "out")
    figures = comparison.figures()["tracking.tip_error_mm.median"]
    np.testing.assert_allclose(figures, [0.5, np.hypot(1.3, 0.4), 0.5])
    changes = {row["path"]: [row[each] for each in "abc"] for row in comparison.changes()}
    assert changes == {"imaging.gain": ["0.42", "0.5", "0.42"], "seed": ["0", "0", "4"]}
    figure = comparison.plot()
    assert [len(axes.get_lines()) for axes in figure.axes] == 5 * [3]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b", "c"]
    assert "imaging.gain" in str(comparison)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<code>imaging.gain</code>" in page
    assert "tip error, median, mm" in page
    kept = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert kept["runs"] == ["a", "b", "c"]


def test_command_prints_the_table(keep, tmp_path):
    one, other = keep("a"), keep("b", **{"imaging.gain": 0.5})
    result = sonoservo_here("compare", str(one), str(other), "--out", str(tmp_path / "out"))
    assert result.returncode == 0, result.stderr
    for text in ("imaging.gain", "0.42", "tip error, median, mm", "report.html"):
        assert text in result.stdout
    again = compare([one, one])
    assert not again.changes()
    assert len(set(again.names)) == 2


def test_figures_that_no_run_has_are_left_out_and_long_names_fold(keep, tmp_path):
    comparison = compare([keep("a"), keep("b", **{"hand.pushes.0.speed": 0.004})])
    console = Console(record=True, width=40)
    console.print(comparison.table())
    first = [line.partition("  ")[0].strip() for line in console.export_text().splitlines()]
    assert "hand.pushes.0.speed" in "".join(first)
    assert "".join(first).index("differs") < "".join(first).index("hand.pushes")
    unknown = [path for path, each in comparison.figures().items() if each == [None, None]]
    assert unknown
    for path in unknown:
        assert comparison.presenter.labels[path] not in comparison.page()


def test_folders_that_are_none_are_named(keep, tmp_path):
    one = keep("a")
    (tmp_path / "empty").mkdir()
    (tmp_path / "tracked").mkdir()
    (tmp_path / "tracked" / "estimates.csv").touch()
    (tmp_path / "circle").symlink_to("circle")
    for other, message in (
        (tmp_path / "nowhere", "there is no such folder"),
        (tmp_path / "empty", "it has no scenario.yaml"),
        (tmp_path / "tracked", "is a folder of track, not of run"),
        (tmp_path / "circle", "there is no such folder"),
    ):
        result = sonoservo_here("compare", str(one), str(other), "--out", str(tmp_path / "out"))
        assert result.returncode == 2
        assert f"{other}" in result.stderr
        assert message in result.stderr
        assert not (tmp_path / "out").exists()
    for text in ("{", "[]", "1"):
        (one / "summary.json").write_text(text)
        with pytest.raises(ConfigurationError, match=r"summary\.json: cannot be read"):
            compare([one, one])


def test_runs_of_different_experiments_or_a_single_one_are_refused(keep):
    one = keep("a")
    with pytest.raises(ConfigurationError, match="a comparison needs at least two"):
        compare([one])
    with pytest.raises(ConfigurationError, match="is one path; expected a list"):
        compare(one)
    (one / "scenario.yaml").write_text(load_scenario("carriere2016_d60").to_yaml())
    with pytest.raises(ConfigurationError, match=r"lacks the arrays|only runs of one experiment"):
        compare([keep("b"), one])
