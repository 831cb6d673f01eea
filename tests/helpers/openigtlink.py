"""The reference library of OpenIGTLink as a referee, where it is installed."""

import shutil
import socket
import subprocess
from pathlib import Path

import pytest

_HEADERS = Path("/usr/include/openigtlink")


def compiled(source: Path, folder: Path) -> Path:
    """Compile a program against the reference library; skip the test where that is not possible."""
    if shutil.which("g++") is None or not _HEADERS.is_dir() or not source.is_file():
        pytest.skip("the reference library is missing: apt-get install g++ libopenigtlink-dev")
    program = folder / source.stem
    command = ["g++", "-w", f"-I{_HEADERS}", str(source), "-o", str(program)]
    subprocess.run([*command, "-lOpenIGTLink", "-lpthread"], check=True, capture_output=True)
    return program


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])
