"""Cases that fail in known ways, which the engine must notice."""

import os
import signal

from fuzzing.engine import MEMORY, judge, run
from sonoservo.systems.files.refusals import ConfigurationError


def misbehave(number, folder):
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


if __name__ == "__main__":
    for outcome in run(misbehave, range(8)):
        print(outcome.number, outcome.result)
