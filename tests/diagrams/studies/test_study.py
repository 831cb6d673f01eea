"""Many runs: resumed, counted, interrupted."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import pytest
from rich.console import Console

from sonoservo.diagrams.studies import Case, Outcome, StudyOptions, fingerprint, run_cases, runs
from sonoservo.diagrams.studies.fingerprint import code_fingerprint, made_by
from sonoservo.diagrams.studies.processes import FinishedOnly, Processes
from sonoservo.diagrams.studies.runs import StudyProgress, run_study
from sonoservo.systems.files.refusals import ConfigurationError


def square(case):
    """Note every call; fail where told to."""
    with open(case.settings["calls"], "a") as calls:
        calls.write(f"{case.seed}\n")
    if case.seed == case.settings.get("raises"):
        raise ValueError("no luck")
    if case.seed == case.settings.get("dies"):
        os._exit(1)
    return {"square": case.seed**2, "nothing": float("nan")}


@pytest.fixture
def calls(tmp_path):
    path = tmp_path / "calls"
    path.touch()
    return path


def make_cases(calls, seeds=range(3), **settings):
    return [Case("squares", seed, {"calls": str(calls), **settings}) for seed in seeds]


def seeds_called(calls):
    return sorted(int(line) for line in calls.read_text().splitlines())


def test_results_come_in_the_order_of_the_cases_and_as_json_holds_them(tmp_path, calls):
    cases = make_cases(calls, [2, 0, 1])
    outcomes = run_cases(square, cases, tmp_path / "cases", jobs=1)
    assert [each.case for each in outcomes] == cases
    assert calls.read_text().split() == ["0", "1", "2"]  # lower seeds are run first
    assert [each.result for each in outcomes] == [{"square": n, "nothing": None} for n in (4, 0, 1)]
    assert all(each and each.wall_s > 0 for each in outcomes)


def test_a_part_of_a_study_is_run_alone(tmp_path, calls):
    cases = [*make_cases(calls), Case("open, x", 7, {"calls": str(calls)})]
    options = StudyOptions(folder=tmp_path, jobs=1, only="open")
    assert [each.case for each in run_study(square, cases, options)] == cases[3:]
    shown = Console(file=io.StringIO(), width=100)
    options = StudyOptions(folder=tmp_path, jobs=1, choose=lambda each: each[:2], console=shown)
    assert [each.case for each in run_study(square, cases, options)] == cases[:2]
    assert " 2/2 " in shown.file.getvalue()  # what is left out is not to come
    with pytest.raises(ConfigurationError, match="no experiment begins with 'x'; squares, open, x"):
        run_study(square, cases, StudyOptions(folder=tmp_path, only="x"))
    with pytest.raises(ValueError, match="all must differ"):
        run_cases(square, 2 * cases, tmp_path)


def test_what_is_done_is_not_done_again(tmp_path, calls):
    first = run_cases(square, make_cases(calls), tmp_path / "cases", jobs=1)
    again = run_cases(square, make_cases(calls, range(5)), tmp_path / "cases", jobs=1)
    assert seeds_called(calls) == [0, 1, 2, 3, 4]
    assert again[:3] == first


def test_a_study_may_consist_of_what_is_finished(tmp_path, calls):
    run_cases(square, make_cases(calls, range(2)), tmp_path / "cases", jobs=1)
    finished = run_cases(square, make_cases(calls), tmp_path / "cases", cluster=FinishedOnly())
    assert [each.case.seed for each in finished] == [0, 1]
    assert seeds_called(calls) == [0, 1]
    options = StudyOptions(folder=tmp_path / "other", cluster=FinishedOnly())
    with pytest.raises(ConfigurationError, match="--finished: no run by this code is in"):
        run_study(square, make_cases(calls), options)


def test_other_settings_other_code_or_a_broken_file_are_done_again(tmp_path, calls, monkeypatch):
    folder = tmp_path / "cases"
    (outcome,) = run_cases(square, make_cases(calls, [1]), folder, jobs=1)
    run_cases(square, make_cases(calls, [1], raises=7), folder, jobs=1)
    assert seeds_called(calls) == [1, 1]
    (folder / f"{outcome.case.name}.json").write_text("{")
    run_cases(square, make_cases(calls, [1]), folder, jobs=1)
    assert seeds_called(calls) == [1, 1, 1]
    for change in ({"sonoservo's code": "another"}, {"instruction set": "another"}):
        monkeypatch.setattr(runs, "made_by", lambda module, more=change: made_by(module) | more)
        run_cases(square, make_cases(calls, [1]), folder, jobs=1)
    assert seeds_called(calls) == [1, 1, 1, 1, 1]


def test_all_code_counts_but_the_rooms_that_show_and_the_results_themselves(tmp_path, monkeypatch):
    for part in ("systems/display", "systems/evaluation/reports", "models", "diagrams"):
        (tmp_path / part).mkdir(parents=True)
    monkeypatch.setattr(
        fingerprint, "files", lambda package: tmp_path / package.removeprefix("sonoservo.")
    )

    def digest_after(path, text):
        (tmp_path / path).write_text(text)
        code_fingerprint.cache_clear()
        return code_fingerprint()

    try:
        first = digest_after("systems/block.py", "a")
        assert digest_after("systems/display/view.py", "a") == first
        assert digest_after("systems/evaluation/reports/page.py", "a") == first
        assert digest_after(f"diagrams/{fingerprint.RECORDS}", "a") == first
        assert digest_after("systems/block.py", "b") != first
        assert digest_after("systems/block.py", "a") == first
        assert digest_after("models/probe.yaml", "a") != first
        # A module's name alone says nothing: here lies what a success is.
        before = digest_after("diagrams/analysis.py", "a")
        assert digest_after("diagrams/analysis.py", "b") != before
        plain = digest_after("systems/block.py", "def f():\n    return 1\n")
        told = 'def f():\n    """Return\n\n    one.\n    """\n    # A reason.\n    return 1\n'
        assert digest_after("systems/block.py", told) == plain
        assert digest_after("systems/block.py", told.replace("1", "2")) != plain
    finally:
        code_fingerprint.cache_clear()


def test_code_counts_where_the_results_come_from_it(tmp_path, monkeypatch):
    changed = ("systems/live/acquisition.py", "systems/evaluation/success.py", "models/clinic.yaml")
    for path in (*changed, "diagrams/seeds.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()
    monkeypatch.setattr(
        fingerprint, "files", lambda package: tmp_path / package.removeprefix("sonoservo.")
    )
    monkeypatch.setattr(fingerprint, "_reached_modules", cache(fingerprint._reached_modules))
    work, unknown = "sonoservo.diagrams.studies.following.analysis", "my_study"
    try:
        found = []
        for path in (None, *changed):
            if path:
                (tmp_path / path).write_text("added: 1\n")
            code_fingerprint.cache_clear()
            found.append((code_fingerprint(work), code_fingerprint(unknown)))
            assert found[-1][1] == code_fingerprint() != found[-1][0]
        assert [len({each[k] for each in found}) for k in (0, 1)] == [3, 4]  # live makes no result
    finally:
        code_fingerprint.cache_clear()


def test_a_case_that_raises_is_a_failure_and_not_the_end(tmp_path, calls):
    outcomes = run_cases(square, make_cases(calls, raises=1), tmp_path / "cases", jobs=1)
    assert [bool(each) for each in outcomes] == [True, False, True]
    assert outcomes[1].error == "ValueError: no luck"
    assert run_cases(square, make_cases(calls, raises=1), tmp_path / "cases", jobs=1) == outcomes
    assert seeds_called(calls) == [0, 1, 2]


def interrupted(case):
    raise SystemError("a kernel returned a result with an exception set") from KeyboardInterrupt()


def test_an_interruption_of_compiled_code_is_no_failure(tmp_path, calls):
    with pytest.raises(KeyboardInterrupt):
        run_cases(interrupted, make_cases(calls), tmp_path / "cases", jobs=1)
    assert not list((tmp_path / "cases").glob("*.json"))


def test_processes_compute_with_one_thread_and_one_that_dies_is_a_failure(tmp_path, calls):
    """In a process of its own: the cases are to be found by their module's name there."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from pathlib import Path\n"
        "from test_study import make_cases, square\n"
        "from sonoservo.diagrams.studies.runs import run_cases\n"
        "def work(case):\n"
        "    assert os.environ['NUMBA_NUM_THREADS'] == os.environ['OMP_NUM_THREADS'] == '1'\n"
        "    return square(case)\n"
        f"cases = make_cases({str(calls)!r}, range(3), dies=1)\n"
        f"outcomes = run_cases(work, cases, Path({str(tmp_path / 'cases')!r}), jobs=2)\n"
        "print([each.error or each.result['square'] for each in outcomes])\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.strip() == "[0, 'its process died', 4]"


def test_interrupted_it_ends_and_keeps_what_is_done(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import sys, time\n"
        "from pathlib import Path\n"
        "from sonoservo.diagrams.studies.runs import run_cases\n"
        "from sonoservo.diagrams.studies.study import Case\n"
        "def work(case):\n"
        "    time.sleep(0.1 if case.seed < 2 else 600)\n"
        "    return {}\n"
        "try:\n"
        "    run_cases(work, [Case('e', k) for k in range(8)], Path(sys.argv[1]), jobs=2)\n"
        "except KeyboardInterrupt:\n"
        "    sys.exit(130)\n"
    )
    folder = tmp_path / "cases"
    process = subprocess.Popen(
        [sys.executable, script, folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while len(list(folder.glob("*.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: every process receives it
    # The output ends when the last process that could write to it does.
    output, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in output
    kept = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    assert sorted(each["case"]["seed"] for each in kept) == [0, 1]


def test_options(tmp_path):
    options = StudyOptions(folder=tmp_path, first_seed=100)
    assert options.seed_range(20, 2) == range(100, 120)
    assert StudyOptions(folder=tmp_path, quick=True).seed_range(20, 2) == range(2)
    assert StudyOptions(folder=tmp_path, seeds=5).seed_range(20, 2) == range(5)
    assert StudyOptions(folder=tmp_path, seeds=5).seed_range(3, 2) == range(3)
    for field, value in (("seeds", 0), ("first_seed", -1), ("jobs", 0)):
        with pytest.raises(ValueError, match=field):
            StudyOptions(folder=tmp_path, **{field: value})


def test_the_line_has_rate_workers_failures_and_time():
    text = io.StringIO()
    cases = [Case("e", seed) for seed in range(3)]
    known = [Outcome(cases[0], wall_s=1.0)]
    with StudyProgress(Console(file=text, width=100), Processes(2), cases[1:], known) as progress:
        for case in cases[1:]:
            progress.advance(Outcome(case, error="ValueError: [no] luck"))
    shown = text.getvalue()
    assert "failed: ValueError: [no] luck" in shown
    assert "3/3 120/min, 2 at once, 2 failed 0:00:00" in shown
