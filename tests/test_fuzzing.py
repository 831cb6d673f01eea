"""The fuzzers on a few cases; `make fuzz` runs many."""

import os
import signal
from functools import partial

import pytest
from fuzzing import files
from fuzzing.commands import command_case
from fuzzing.engine import MEMORY, Outcome, judge, run
from fuzzing.files import file_case
from fuzzing.kills import kill_case
from fuzzing.scenarios import run_case, scenario_case

from sonoservo.systems.files.refusals import ConfigurationError


@pytest.fixture(autouse=True, scope="module")
def _bases():
    files.bases()


@pytest.mark.parametrize(
    ("case", "count"), [(file_case, 150), (scenario_case, 30), (command_case, 6), (run_case, 1)]
)
def test_no_damage_breaks_the_program(case, count):
    outcomes = run(partial(case, seed=1), range(count))
    assert len(outcomes) == count
    assert [each for each in outcomes if each.finding] == []
    assert {each.result for each in outcomes} <= {"good", "refused"}


@pytest.mark.slow
def test_an_end_at_any_moment_leaves_readable_files_and_no_process():
    outcomes = run(kill_case, range(24))
    assert [each for each in outcomes if each.finding] == []


def _misbehave(number, folder):
    """Fail in a way of its own for each number."""

    def act():
        if number == 0:
            raise ConfigurationError("a.nrrd: it is empty")
        if number == 1:
            raise IndexError("a fault of the program")
        if number == 2:
            raise ConfigurationError("it does not name the file")
        if number == 3:
            return len(bytearray(int(1.5 * MEMORY)) or b"") * 0.0
        if number == 4:
            bytearray(int(20 * MEMORY))
        if number == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        assert number != 6, "a wrong result"
        return 0.0

    return judge("case", act, "a.nrrd")


def test_the_engine_notices_what_is_wrong():
    outcomes: list[Outcome] = run(_misbehave, range(8))
    assert [each.number for each in outcomes] == list(range(8))
    wanted = ["refused", "bug", "message", "memory", "memory", "died", "wrong", "good"]
    assert [each.result for each in outcomes] == wanted
