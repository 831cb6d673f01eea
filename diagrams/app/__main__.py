"""The program ``sonoservo``: the command line, and what ends it from outside."""

import sys

from sonoservo.diagrams.app.interruption import INTERRUPTED, catch_interruptions, interrupted_code


def main() -> None:
    """Run the command line as a program of its own."""
    try:
        catch_interruptions()
        # Loaded here, so that Ctrl-C ends the program quietly while it loads.
        from sonoservo.diagrams.app.cli import run_arguments

        code = run_arguments(sys.argv[1:])
    except KeyboardInterrupt:
        code = INTERRUPTED
    sys.exit(interrupted_code() if code == INTERRUPTED else code)


if __name__ == "__main__":
    main()
