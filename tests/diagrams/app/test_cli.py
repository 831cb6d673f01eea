import json
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from commands import sonoservo_here
from PIL import Image
from typer.testing import CliRunner

from sonoservo.diagrams import list_scenarios, load_scenario
from sonoservo.diagrams.app.cli import app, run_arguments
from sonoservo.diagrams.app.options import free_folder
from sonoservo.systems.evaluation import RunLog, read_log
from sonoservo.systems.evaluation.explanation.explained_volume import FOLDER

runner = CliRunner()

COARSE = ["station.plant.contact_model=point", "imaging.sector=0.4"]
"""Changes that make a run faster."""


def test_list_names_every_scenario_and_dial(tmp_path):
    result = runner.invoke(app, ["list", "--json", str(tmp_path / "list.json")])
    assert result.exit_code == 0
    assert "chatelain2013_fig5" in result.stdout
    rows = json.loads((tmp_path / "list.json").read_text())
    assert rows["scenarios"] == {name: load_scenario(name).description for name in list_scenarios()}
    assert all(rows["scenarios"].values())
    assert rows["dials"]["dip"]["moderate"] == {"hand.dip_deg": 60.0}
    lines = result.stdout.splitlines()
    assert "--set hand.dip_deg=60.0  # dip: 60 deg" in lines
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    alone = runner.invoke(app, ["list", "--json", "-"])
    assert json.loads(alone.stdout) == rows
    assert "chatelain2013_fig5" in alone.stderr


def test_results_of_an_earlier_run_are_not_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert free_folder("fig5_seed0") == Path("out/fig5_seed0")
    for name in ("fig5_seed0", "fig5_seed0_2"):
        (tmp_path / "out" / name).mkdir(parents=True)
    assert free_folder("fig5_seed0") == Path("out/fig5_seed0_3")


def test_version_and_help_are_where_people_look():
    assert runner.invoke(app, ["--version"]).stdout == f"sonoservo {version('sonoservo')}\n"
    assert runner.invoke(app, ["run", "-h"]).stdout.strip().startswith("Usage:")


def test_a_scenario_of_one_s_own_begins_as_a_copy(tmp_path):
    path = tmp_path / "mine.yaml"
    assert runner.invoke(app, ["new", str(path), "--from", "clinic"]).exit_code == 0
    copy, original = load_scenario(path), load_scenario("clinic")
    assert copy == replace(original, name="mine")
    shown = tmp_path / "shown.yaml"
    shown.write_text(runner.invoke(app, ["show", str(path)]).stdout)
    assert load_scenario(shown) == copy
    changed = runner.invoke(app, ["show", str(path), "--set", "duration=5"]).stdout
    assert "duration: 5.0" in changed
    before = path.read_text()
    again = sonoservo_here("new", str(path))
    assert (again.returncode, path.read_text()) == (2, before)
    assert "exists already" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("run chatelain2031_fig5", "did you mean 'chatelain2013_fig5'"),
        ("run chatelain2013_fig5 --set station.probe.x=3", "cannot reach"),
        ("run chatelain2013_fig5 --set station.arm=nowhere.yaml", "no file nowhere.yaml"),
        ("run carriere2016_d60 --record a.seq.nrrd", "record: not possible"),
        ("run chatelain2013_fig5 --movie a.avi", "a.avi must end in .gif or .mp4"),
        ("run chatelain2013_fig5 --record a.mha", "must end in .seq.nrrd"),
        ("run carriere2016_d60 --click --set depth=0.9", "stays in the phantom"),
        ("run chatelain2013_fig5 --click", "one of 'shape_prediction' is needed here"),
        ("run chatelain2013_fig5 --no-meshcat --out a.mha/out", "a.mha"),
        ("reproduce chatelain2031", "unknown paper 'chatelain2031'; did you mean 'chatelain2013'?"),
        ("reproduce chatelain2013 --seeds 0", "seeds: 0 is not allowed; it must be 1 or more"),
        (
            "reproduce chatelain2013 --repeat 2 --out out",
            "--repeat: it takes the kept runs as they are; leave out --quick, --seeds, "
            "--first-seed, --only, --finished, --add and --out",
        ),
        ("track a.mha", "a.mha: not a MetaImage file"),
        ("locate a.mha", "a.mha: not a MetaImage file"),
        ("locate a.mha --json .", "--json: . is a folder"),
        ("locate a.mha --json ./a.mha", "--json: a.mha is the volume itself"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2_and_leaves_nothing(
    arguments, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mha").write_bytes(b"NRRD0005\n")
    result = sonoservo_here(*arguments.split())
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["a.mha"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["run", "chatelain2013_fig6", "--duration", "3"],
            "No such option: --duration. A scenario's fields are set by --set, such as "
            "--set duration=3. `sonoservo run --help` lists the options.",
        ),
        (["track", "x", "--no-meshcat"], "--no-meshcat. It is an option of `sonoservo run`."),
        (["list", "--foo"], "No such option: --foo. `sonoservo list --help` lists the options."),
        (["explain", "out", "--time", "abc"], "'abc'"),
        (["rnu"], "`sonoservo --help` lists the commands and their options."),
        (
            ["dataset", "clinic", "--count", "2", "--out", "q", "--layout", "coco"],
            "layout: 'coco' is not allowed; known: lerobot, nnunet, sequences, zea",
        ),
    ],
)
def test_a_mistake_on_the_command_line_says_what_is_allowed(arguments, message, capsys):
    assert run_arguments(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ("--motor nofile.yaml", "connections"),
        ("--clock-offset 0", "connections"),
        ("--volumes 2", "connections"),
        ("--patience 1", "connections"),
        ("--serve igtl://:0", "connections"),
        ("--name tip=X", "connections"),
        ("--points", "connections"),
        ("--frames 5", "frames, with --reconstruct"),
        ("--spacing 1", "frames, with --reconstruct"),
    ],
)
def test_an_option_without_effect_on_a_file_is_refused(options, what, capsys):
    assert run_arguments(["track", "a.mha", *options.split()]) == 2
    assert f"{options.split()[0]}: it is for {what}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("locate a.mha --motor b.yaml", "--motor: it is for connections"),
        ("check a.mha --seconds 2", "--seconds: it is for connections"),
        ("calibrate a.mha --clock-offset 1", "--clock-offset: it is for connections"),
        ("bridge a.mha igtl://:0 --volumes 2", "--volumes: it is for connections"),
        ("bridge igtl://localhost:1 a.seq.nrrd --spacing 1", "--spacing: it is for frames"),
        ("check igtl://localhost:1 --volume-rate 2", "--volume-rate: it is for files"),
        ("track igtl://localhost:1 --real-time", "--real-time: not possible with live volumes"),
    ],
)
def test_an_option_without_effect_is_refused_by_every_command(arguments, message, capsys):
    assert run_arguments(arguments.split()) == 2
    assert message in capsys.readouterr().err


def test_a_run_that_cannot_go_on_says_why_and_ends_with_status_3(tmp_path):
    out = tmp_path / "out"
    fault = "station.sensor_faults=[{kind: nan, start: 0.6, duration: 9}]"
    changes = ["--set", "duration=1.2", "--set", fault, "--set", "imaging.sector=0.3"]
    result = sonoservo_here(
        "run", "chatelain2013_fig5", *changes, "--no-meshcat", "--out", str(out)
    )
    assert result.returncode == 3, result.stderr
    assert "stopped because the wrist sensor's samples are not" in result.stdout
    guard = json.loads((out / "summary.json").read_text())["guard"]
    assert guard["interventions"] == 1
    assert guard["stopped_at_end"] == "the wrist sensor's samples are not numbers"
    log = read_log(out / "log.npz", RunLog)
    assert set(log.guard_state) == {"monitoring", "retreating", "holding"}


def test_a_short_run_leaves_its_files_and_its_summary(tmp_path):
    out = tmp_path / "out"
    (out / FOLDER).mkdir(parents=True)
    (out / FOLDER / "0001.000s.npz").write_bytes(b"of an earlier run")
    changes = ["duration=2.5", "controller.force.force=4", "station.probe.height=0.004", *COARSE]
    result = sonoservo_here(
        "run", "chatelain2013_fig5", "--no-meshcat", "--replay", "--movie", str(tmp_path / "a.gif"),
        "--out", str(out), "--json", str(tmp_path / "summary.json"),
        *(each for change in changes for each in ("--set", change)),
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    with Image.open(tmp_path / "a.gif") as movie:
        assert movie.n_frames == 8
    names = (
        "scenario.yaml summary.json slices.npz log.npz run.png errors.png report.html replay.html"
    )
    assert {path.name for path in out.iterdir()} == set(names.split())
    report = (out / "report.html").read_text()
    assert "<strong>No needle was found.</strong>" in report
    assert 'href="replay.html"' in report
    assert 'href="../a.gif"' in report
    assert "Simulated time, in s" in report
    assert "Key frames" in report
    summary = json.loads((out / "summary.json").read_text())
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["simulated_s"] == pytest.approx(2.5)
    assert summary["interrupted"] is False
    # The error is that from the force that was asked for.
    assert summary["force"]["mean_n"] == pytest.approx(4, abs=0.2)
    assert summary["force"]["rms_error_n"] < 0.2


def test_help_and_list_load_nothing_that_takes_long():
    code = """
import sys
from contextlib import suppress
from sonoservo.diagrams.app.__main__ import main
with suppress(SystemExit):
    main()
print([name for name in ("numpy", "scipy", "numba", "pydrake") if name in sys.modules])
"""
    for arguments in (["run", "--help"], ["list"]):
        result = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
        )
        assert ("scenario" if arguments == ["list"] else "Usage:") in result.stdout
        assert result.stdout.strip().splitlines()[-1] == "[]"
