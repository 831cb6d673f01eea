"""The time left of a study, from the first second, and the line that shows it."""

import io

import pytest
from rich.console import Console

from sonoservo.diagrams.studies.processes import Processes
from sonoservo.diagrams.studies.progress import StudyProgress, TimeLeft
from sonoservo.diagrams.studies.study import Case, Outcome


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def outcome(seed, wall_s, experiment="e", error=""):
    return Outcome(Case(experiment, seed), wall_s=wall_s, error=error)


def test_before_a_case_has_ended():
    left = TimeLeft([Case("e", seed) for seed in range(100)], clock=(clock := Clock()))
    assert left.seconds(10) == pytest.approx(15 * 100 / 10)
    clock.now = 5
    assert left.seconds(10) == pytest.approx(150 - 5)
    clock.now = 100  # the cases take much longer than expected
    assert left.seconds(10) > 1000
    assert left.seconds(0) is None


def test_estimates_approach_the_truth():
    cases = [Case("short", k) for k in range(40)] + [Case("long", k) for k in range(40)]
    left = TimeLeft(cases, clock=(clock := Clock()))
    for seed in range(20):
        for name, seconds in (("short", 2.0), ("long", 60.0)):
            left.ended(outcome(seed, seconds, name))
    assert left.seconds(4) == pytest.approx(20 * 62 / 4, rel=0.05)
    for seed in range(20, 40):
        left.ended(outcome(seed, 2.0, "short"))
    assert left.seconds(4) == pytest.approx(20 * 60 / 4, rel=0.05)
    clock.now = 10
    assert left.seconds(4) == pytest.approx(20 * 60 / 4 - 10, rel=0.05)
    for seed in range(20, 40):
        left.ended(outcome(seed, 60.0, "long"))
    assert left.seconds(4) == 0


def test_earlier_outcomes_count():
    known = [outcome(seed, 100.0) for seed in range(50)]
    left = TimeLeft([Case("e", 99)], known, clock=Clock())
    assert left.seconds(8) == pytest.approx(100, rel=0.05)


def test_the_line_has_rate_workers_failures_and_time():
    text = io.StringIO()
    console = Console(file=text, width=100)
    cases = [Case("e", seed) for seed in range(3)]
    with StudyProgress(console, Processes(2), cases[1:], [outcome(0, 1.0)]) as progress:
        progress.advance(outcome(1, 1.0, error="ValueError: [no] luck"))
        assert progress.status().startswith("60/min, 2 at once, 1 failed, ~")
    assert "failed: ValueError: [no] luck" in text.getvalue()
    assert "2/3" in text.getvalue()
