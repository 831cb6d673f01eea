from contextlib import suppress
from pathlib import Path

import pytest
import typer
from numba.core.event import end_event, start_event
from rich.console import Console

from sonoservo.diagrams import RunResult, load_scenario
from sonoservo.diagrams.app.options import with_common_options
from sonoservo.diagrams.app.run_result import summary_table
from sonoservo.diagrams.app.terminal import end_run, run_progress, volume_progress
from sonoservo.systems.evaluation.compile_free_clock import COMPILATION
from sonoservo.systems.evaluation.reports.verdict import following_verdict
from sonoservo.systems.files.refusals import ConfigurationError

NEEDLE = {"tracking": {"tracked": 4, "volumes": 5}}


def result(failure=None, **summary):
    summary = {"scenario": "fig", "seed": 0, **summary}
    return RunResult(
        summary=summary, log=None, labels={}, failure=failure, verdict=following_verdict(summary)
    )


@pytest.mark.parametrize("stopped", [None, "the force is 12 N"])
@pytest.mark.parametrize("reason", [None, "Nothing [moved]."])
def test_the_table_says_why_no_needle_was_found_and_why_the_robot_stands(stopped, reason):
    console = Console(record=True, width=200)
    detection = {"reason": reason, "advice": "Push."} if reason else {"volume": 3}
    console.print(
        summary_table(result(detection=detection, guard={"stopped_at_end": stopped}, **NEEDLE))
    )
    said = " ".join(console.export_text().split())
    assert ("No needle was found. Nothing [moved]. Push." in said) == (reason is not None)
    assert (f"still stopped at the end because {stopped}" in said) == (stopped is not None)
    assert ("The guard stopped the robot" in said) == (stopped is not None)


def test_numbers_stay_with_their_units():
    tracking = NEEDLE["tracking"] | {
        "tip_error_mm": {"median": 0.5, "p95": 1.5},
        "consistency": {"tip": {"within_95": 1.0}},
    }
    shown = result(detection={"volume": 3}, success={"found": True}, tracking=tracking)
    for width in range(30, 60):
        console = Console(record=True, width=width)
        console.print(summary_table(shown))
        said = console.export_text()
        assert "100 % inside" in " ".join(said.split())
        assert not any(line.split()[:1] in (["%"], ["mm"]) for line in said.splitlines())


def test_a_file_that_was_not_written_goes_before_the_exit_status():
    end_run(result(guard={"stopped_at_end": None}, force={"touched": True}))
    for bad in ({"guard": {"stopped_at_end": "the force is 12 N"}}, {"force": {"touched": False}}):
        with pytest.raises(typer.Exit) as ended:
            end_run(result(**bad))
        assert ended.value.exit_code == 3
    with pytest.raises(OSError, match="disk full"):
        end_run(result(OSError("disk full"), guard={"stopped_at_end": "the force is 12 N"}))


def test_a_name_that_no_file_could_hold_is_refused_before_the_work():
    def command(*, out: Path):
        raise AssertionError("it ran")

    with pytest.raises(ConfigurationError, match=r"out: 'a.udce9b' is not UTF-8"):
        with_common_options(command)(out=Path("a\udce9b"), debug=False, max_memory=None)


@pytest.mark.parametrize("kernels", [0, 2])
def test_compilation_is_spoken_of_once_if_there_is_any(kernels):
    console = Console(record=True, force_terminal=False)
    with run_progress(console, load_scenario("clinic")):
        for _ in range(kernels):
            start_event(COMPILATION)
            end_event(COMPILATION)
    said = ["Simulating clinic, 32 s ...", "Compiling kernels, once on this machine ..."]
    assert console.export_text().splitlines() == said[: 1 + bool(kernels)]


@pytest.mark.parametrize("done", [0, 3])
def test_an_error_leaves_no_empty_bar(done):
    console = Console(record=True, force_terminal=True, width=100)
    with suppress(ValueError), volume_progress(console, "Tracking", "a.mha", 4) as progress:
        if done:
            progress.show(done, "lost")
        raise ValueError
    assert ("volume 3 of 4  lost" in console.export_text()) == bool(done)
    assert "starting" not in console.export_text()
