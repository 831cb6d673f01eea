"""Process in which a worker runs cases: ``python -m ...case_process HANDLE PARENT``."""

import pickle
import sys
from multiprocessing.connection import Connection

from sonoservo.diagrams.studies.fingerprint import package_identity
from sonoservo.diagrams.studies.processes import follow_parent
from sonoservo.diagrams.studies.study import perform
from sonoservo.systems.files.refusals import describe

IDLE_S = 60.0
"""Time in s after which a process without a case ends."""


def serve(connection: Connection) -> None:
    """Run the cases that come through a connection, until it closes or nothing comes for long.

    The first message is the `package_identity` of this process. Each case is answered by a pair:
    "finished" and the `Finished` case, or "unloadable" and why the function cannot be loaded.
    """
    connection.send(package_identity())
    while connection.poll(IDLE_S):
        try:
            message = connection.recv_bytes()
        except EOFError:
            return
        try:
            work, store, case = pickle.loads(message)
        except Exception as error:
            connection.send(("unloadable", f"{type(error).__name__}: {describe(error)}"))
            continue
        connection.send(("finished", perform(work, case, store)))


if __name__ == "__main__":
    follow_parent(int(sys.argv[2]))
    serve(Connection(int(sys.argv[1])))
