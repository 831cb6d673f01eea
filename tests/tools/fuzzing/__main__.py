"""Run the fuzzers: ``python -m fuzzing [--files 10000] [--scenarios 5000] [--runs 300] ...``."""

import argparse
import sys
from functools import partial

from fuzzing.commands import command_case
from fuzzing.engine import run, summary
from fuzzing.files import bases, file_case
from fuzzing.kills import kill_case, recorded
from fuzzing.scenarios import built_in_scenarios, compile_for_runs, run_case, scenario_case

CASES = {
    "files": (10_000, file_case),
    "scenarios": (5_000, scenario_case),
    "runs": (300, run_case),
    "commands": (500, command_case),
    "kills": (50, kill_case),
}


def main() -> int:
    """Run as many cases of each kind as asked for; return 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, (count, _) in CASES.items():
        parser.add_argument(f"--{name}", type=int, default=count, help=f"{count} by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    options = parser.parse_args()
    bases()
    built_in_scenarios()
    if options.runs:
        compile_for_runs()
    if options.kills:
        recorded()
    found = 0
    for name, (_, case) in CASES.items():
        if count := getattr(options, name):
            numbers = range(options.first, options.first + count)
            outcomes = run(partial(case, seed=options.seed), numbers)
            findings = [outcome for outcome in outcomes if outcome.finding]
            found += len(findings)
            for each in findings[:20]:
                print(f"--- {name} {each.number}: {each.result}: {each.what}\n{each.detail}")
            print(summary(name, outcomes))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
