"""A recorded run as a web page that plays by itself."""

from pathlib import Path

from pydrake.geometry import Meshcat

from sonoservo.systems.files.writing import write_atomically


def save_replay(meshcat: Meshcat, path: str | Path) -> Path:
    """Write what a Meshcat has recorded as one HTML page, which needs no server.

    Call ``meshcat.StartRecording()`` before the simulator is initialised: what was shown or hidden
    earlier is not in the recording. The live page, if one is open, plays the recording too.

    Returns
    -------
    The path.
    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return write_atomically(path, meshcat.StaticHtml())
