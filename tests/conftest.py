"""Settings of the test session."""

import signal

from hypothesis import settings

import sonoservo.systems  # noqa: F401  (one thread for PyMUST's matrices, too)

# The first example may have to wait for a kernel to be compiled.
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")

# Started in the background, a suite ignores these, and so would the programs that it interrupts.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, lambda number, frame: None)


def pytest_terminal_summary(terminalreporter):
    """Say so loudly where the tests in a browser did not run."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = [each.longrepr[2] for each in skipped if isinstance(each.longrepr, tuple)]
    blind = [reason for reason in reasons if "no Chromium" in reason]
    if blind:
        terminalreporter.section("THE SCREENS WERE NOT TESTED", sep="!", red=True, bold=True)
        terminalreporter.line(f"{len(blind)} tests: {blind[0].removeprefix('Skipped: ')}")
