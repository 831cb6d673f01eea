import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
import yaml

from sonoservo.diagrams import FollowingScenario, load_scenario, run
from sonoservo.diagrams.dials import load_dials
from sonoservo.diagrams.papers.chatelain2013.method.tracker import (
    Chatelain2013AsPublishedParameters,
)
from sonoservo.diagrams.papers.zhao2012.method.tracker import Zhao2012AsPublishedParameters
from sonoservo.diagrams.trackers import Zhao2012TrackerParameters
from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import dump_typed
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter


def test_changes_and_seed_are_laid_over_the_file():
    scenario = load_scenario(
        "chatelain2013_fig5", changes=["hand.gauge=22", "hand.pushes.0.speed=0.001"], seed=7
    )
    assert scenario.hand.gauge == 22
    assert scenario.hand.pushes[0].speed == 0.001
    assert scenario.hand.pushes[1] == load_scenario("chatelain2013_fig5").hand.pushes[1]
    assert scenario.seed == 7


def test_a_file_of_ones_own_and_the_whole_of_it_read_back(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("duration: 3.5\nimaging: {volume_rate: 2.0}\n")
    scenario = load_scenario(path)
    assert scenario.name == "mine"
    assert scenario.imaging.volume_rate == 2.0
    path.write_text(scenario.to_yaml())
    assert load_scenario(path) == scenario
    assert set(yaml.safe_load(scenario.to_yaml())) == set(FollowingScenario.__dataclass_fields__)


def copy_models(target, prefix=""):
    for folder, name in (("probes", "4dc7_3_40"), ("robots", "ur5e"), ("phantoms", "agar")):
        text = model_path(f"{folder}/{name}.yaml").read_text()
        (target / f"{prefix}{name}.yaml").write_text(text)


def test_a_scenario_with_parts_of_ones_own_reads_back_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    copy_models(tmp_path)
    changes = ["probe=4dc7_3_40.yaml", "station.arm=ur5e.yaml", "phantom=./agar.yaml"]
    text = load_scenario("chatelain2013_fig5", changes=changes).to_yaml()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (tmp_path / "kept.yaml").write_text(text)
    read = load_scenario("../kept.yaml")
    assert all(Path(each).is_file() for each in (read.probe, read.station.arm, read.phantom))
    assert read.needle == load_scenario("chatelain2013_fig5").needle


def test_files_lie_beside_the_scenario_that_names_them(tmp_path):
    copy_models(tmp_path, "my_")
    (tmp_path / "mine.yaml").write_text(
        "probe: my_4dc7_3_40.yaml\nphantom: my_agar.yaml\nstation: {arm: my_ur5e.yaml}\n"
    )
    read = load_scenario(tmp_path / "mine.yaml")
    named = (read.probe, read.station.arm, read.phantom)
    assert [Path(each).parent for each in named] == 3 * [tmp_path]


def test_the_tracker_is_chosen_by_name(tmp_path):
    changes = ["tracker=zhao2012", "tracker.velocimeter=speckle"]
    changes += ["tracker.velocimeter.min_correlation=0.4"]
    changes += ["tracker.filter.turning=1e-4"]
    scenario = load_scenario("chatelain2013_fig5", changes=changes)
    assert isinstance(scenario.tracker, Zhao2012TrackerParameters)
    assert scenario.tracker.velocimeter.min_correlation == 0.4
    assert scenario.tracker.filter == AxisTipFilter(turning=1e-4)
    path = tmp_path / "mine.yaml"
    path.write_text(scenario.to_yaml())
    assert load_scenario(path).tracker == scenario.tracker
    filtered = load_scenario("chatelain2013_fig5", changes=["tracker.filter=axis_tip"])
    assert filtered.tracker.filter == AxisTipFilter()


def test_as_published_sets_tracker_and_controller_below_the_file_and_the_changes():
    scenario = load_scenario("chatelain2013_fig5", as_published=True, changes=["tracker.order=3"])
    assert scenario.name == "chatelain2013_fig5_as_published"
    assert scenario.tracker == Chatelain2013AsPublishedParameters(order=3)
    servo = scenario.controller.visual_servo
    assert (servo.feed_forward, servo.held, servo.gain) == (False, True, 0.8)
    assert scenario.hand == load_scenario("chatelain2013_fig5").hand
    still = load_scenario("chatelain2013_fig4", as_published=True)
    assert still.controller.visual_servo.gain == 0


def test_as_published_keeps_the_tracker_of_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("tracker: {kind: chatelain2013_as_published, order: 3}\n")
    assert load_scenario(path, as_published=True).tracker.order == 3
    path.write_text("tracker: {track: {act: 0.9}}\n")
    with pytest.raises(ConfigurationError, match=r"tracker.track: unknown field"):
        load_scenario(path, as_published=True)


@pytest.mark.parametrize("changes", [["tracker=zhao2012"], ["tracker=zhao2012_as_published"]])
def test_as_published_takes_the_published_form_of_the_chosen_tracker(changes, tmp_path):
    scenario = load_scenario("chatelain2013_fig5", as_published=True, changes=changes)
    assert scenario.tracker == Zhao2012AsPublishedParameters()
    assert scenario.controller.visual_servo.held
    path = tmp_path / "mine.yaml"
    path.write_text("tracker: zhao2012\n")
    assert load_scenario(path, as_published=True).tracker == scenario.tracker


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("chatelain2013_fig", [], "did you mean 'chatelain2013_fig"),
        ("nowhere.yaml", [], "nowhere.yaml: cannot be read"),
        (
            "chatelain2013_fig5",
            ["station.time_step=0.01"],
            "station.time_step: unknown field; did you mean 'station.plant.time_step'",
        ),
        ("chatelain2013_fig5", ["station.plant.time_step=fast"], "plant.time_step: 'fast'"),
        ("chatelain2013_fig5", ["seed=-1"], "seed: -1"),
        ("carriere2016_d60", ["hand.feed=null"], "hand.feed"),
        ("drive", ["controller_changes=[{force: 0.3}]"], "controller_changes.0.force: 0.3"),
        ("drive", ["controller_changes=[{time: 2}, {time: 1}]"], "must be in order of time"),
        ("chatelain2013_fig5", ["name=../../elsewhere"], "name: '../../elsewhere'"),
        ("chatelain2013_fig5", ["tracker=zhao2012", "tracker.order=3"], "must be 2 (straight)"),
        (
            "chatelain2013_fig5",
            ["tracker.filter.kind=axis_tips"],
            "tracker.filter: unknown kind 'axis_tips'; did you mean 'axis_tip'?",
        ),
    ],
)
def test_mistakes_are_one_clear_line(name, changes, message):
    with pytest.raises(ConfigurationError) as error:
        load_scenario(name, changes=changes)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_child_that_was_forked_after_a_run_says_so():
    scenario = load_scenario("chatelain2013_fig5", changes=["duration=0.05"])
    run(scenario)
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool,
        pytest.raises(ConfigurationError, match="forked .* 'spawn' or 'forkserver'"),
    ):
        pool.submit(run, scenario).result(timeout=60)


def test_a_pixel_larger_than_a_slice_is_refused_before_the_run():
    with pytest.raises(ConfigurationError, match="pixel: 0.03 .* at most 0.01568 m"):
        run(load_scenario("carriere2016_d80", changes=["pixel=0.03"]))


def test_another_probe_chooses_a_frequency_unless_one_is_given_or_fits(tmp_path):
    def frequency(scenario, *changes):
        return load_scenario(scenario, changes=changes).imaging.transmit_frequency

    file = tmp_path / "mine.yaml"
    file.write_text("{probe: 4dl14_5_38, imaging: {gain: 0.5}}")
    assert frequency(file) == frequency("clinic", "probe=4dl14_5_38") == 9.5e6
    assert frequency(file, "probe=trus") == 6.25e6
    assert frequency("clinic", "probe=matrix") == 3.3e6
    assert frequency("clinic", "probe=trus", "imaging.transmit_frequency=6e6") == 6e6
    file.write_text("{probe: trus, imaging: {transmit_frequency: 3.3e6}}")
    assert frequency(file) == 3.3e6  # a mistake of one's own, which is said
    assert frequency(load_scenario("carriere2016_d60"), "probe=matrix") == 3.5e6
    with pytest.raises(ConfigurationError, match="clinic: probe: there is no 'linear'"):
        frequency("clinic", "probe=linear")


def test_another_needle_brings_its_gauge_and_echo_unless_they_are_given(tmp_path):
    def needle(*changes):
        loaded = load_scenario("chatelain2013_fig5", changes=changes)
        return loaded.hand.gauge, loaded.scanner.needle

    gauge, echo = needle()
    assert gauge != needle("needle=spinal")[0] == 22
    assert echo != needle("needle=echogenic")[1]
    assert needle("hand.gauge=20", "needle=spinal")[0] == 20
    mine = tmp_path / "mine.yaml"
    mine.write_text("gauge: 180")
    with pytest.raises(ConfigurationError, match="gauge: 180"):
        needle(f"needle={mine}")


def field(scenario, path):
    for name in path.split("."):
        scenario = scenario[int(name)] if name.isdigit() else getattr(scenario, name)
    return scenario


@pytest.mark.parametrize("name", load_dials())
def test_a_dial_sets_fields_of_a_scenario(name):
    dial = load_dials()[name]
    plain = load_scenario("chatelain2013_fig5")
    turned = load_scenario("chatelain2013_fig5", changes=dial.changes())
    assert dump_typed(plain) != dump_typed(turned)
    for path, moderate in dial.moderate.items():
        assert field(turned, path) == moderate
        if isinstance(moderate, float):
            off, half = dial.plain.get(path, 0.0), dial.changes(0.5)
            assert f"{path}={off + 0.5 * (moderate - off)}" in half
            if path != "hand.pushes.0.speed":
                assert field(plain, path) in (off, 5.0)  # the papers' needles dip by 5 deg
