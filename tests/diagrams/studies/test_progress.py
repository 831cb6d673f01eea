import io

from rich.console import Console

from sonoservo.diagrams.studies.processes import Processes
from sonoservo.diagrams.studies.runs import StudyProgress
from sonoservo.diagrams.studies.study import Case, Outcome


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
