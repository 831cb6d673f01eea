"""Command that prints the table of the study."""

import argparse

from .runs import study_sequences, study_volumes
from .tables import table_of_sequences, table_of_volumes


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--volumes", type=int, default=60, help="volumes with, and without needle")
    parser.add_argument("--sequences", type=int, default=24)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--verbose", action="store_true", help="print a line for each case")
    chosen = parser.parse_args(arguments)

    def say(line):
        print(line, flush=True)

    detail = say if chosen.verbose else None
    if chosen.volumes:
        for line in table_of_volumes(study_volumes(chosen.volumes, chosen.first_seed, detail)):
            say(line)
    if chosen.sequences:
        for line in table_of_sequences(
            study_sequences(chosen.sequences, chosen.first_seed, detail)
        ):
            say(line)


if __name__ == "__main__":
    main()
