import json

import pytest
from matplotlib.figure import Figure

from sonoservo.diagrams import RunResult, load_scenario, run
from sonoservo.diagrams.experiments.following_presenter import following_words
from sonoservo.diagrams.experiments.scenario_changes import base_of, changed_fields
from sonoservo.diagrams.experiments.shape_prediction_presenter import (
    ShapePredictionPresenter,
    shape_words,
)
from sonoservo.systems.files.refusals import ConfigurationError

SHORT = {"depth": 0.02, "observe_until": 0.01, "rotations": [], "step": 2e-3}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    return run("carriere2016_d60", changes=SHORT, seed=100, out=str(out), movie=out / "a.gif")


def test_a_run_by_name_with_changes_keeps_its_files(result):
    assert isinstance(result, RunResult)
    assert result.summary["seed"] == 100
    assert result.summary["tracking"]["slices"] == 11
    assert result.log.depth[-1] == pytest.approx(0.02)


def test_the_summary_is_written_before_anything_is_drawn(monkeypatch, tmp_path, capsys):
    def ended(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(ShapePredictionPresenter, "plots", ended)
    with pytest.raises(KeyboardInterrupt):
        run("carriere2016_d60", changes=SHORT, seed=100, out=tmp_path, progress=True)
    assert "carriere2016_d60" in capsys.readouterr().out
    assert json.loads((tmp_path / "summary.json").read_text())["seed"] == 100


def test_a_result_prints_and_draws_itself(result):
    text = str(result)
    assert "carriere2016_d60, seed 100" in text
    assert result.verdict.headline in " ".join(text.split())
    assert result.verdict.headline in result._repr_html_().replace("\xa0", " ")
    assert "cross-section found" in result._repr_html_()
    assert isinstance(result.plot(), Figure)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": 5}, "scenario: a value of type int; expected the name"),
        ({"changes": "imaging.gain=0.5"}, "of type str; expected a mapping such as"),
        ({"changes": {"imaging.depth": 90}}, "lengths are in m"),
        ({"replay": True}, "replay: there is no folder"),
    ],
)
def test_a_mistake_is_a_sentence(arguments, message):
    with pytest.raises(ConfigurationError, match=message):
        run(**{"scenario": "chatelain2013_fig5", **arguments})


def test_changes_are_those_from_the_built_in_scenario_or_from_the_defaults():
    changed = load_scenario("chatelain2013_fig5", changes={"imaging.gain": 0.5, "seed": 4})
    base, name = base_of(changed)
    assert name == "the built-in scenario chatelain2013_fig5"
    (change,) = changed_fields(base, changed)
    assert (change.path, change.before, change.after) == ("imaging.gain", "0.42", "0.5")
    assert change.meaning
    assert len(changed_fields(load_scenario("chatelain2013_fig5"), changed, seed=True)) == 2
    drawn = load_scenario("clinic", seed=7)
    assert not changed_fields(base_of(drawn)[0], drawn)
    fewer = load_scenario("chatelain2013_fig5", changes={"name": "mine", "hand.pushes": []})
    assert base_of(fewer)[1] == "the defaults of the experiment 'following'"
    gone = {each.path: each.after for each in changed_fields(base, fewer)}
    assert gone["hand.pushes.2.speed"] == "–"


def test_scenarios_are_put_in_words():
    words = " ".join(following_words(load_scenario("chatelain2013_fig6")))
    assert "pushed by 72 mm at 8 mm/s" in words
    assert "The phantom is moved at 18, 25, 31, 38 s." in words
    assert "The phantom breathes by 5 mm, 15 times a minute." in " ".join(
        following_words(load_scenario("clinic"))
    )
    still = " ".join(following_words(load_scenario("chatelain2013_fig4")))
    assert "so the probe only presses" in still
    assert "turned at 60 mm" in " ".join(shape_words(load_scenario("carriere2016_d60")))
