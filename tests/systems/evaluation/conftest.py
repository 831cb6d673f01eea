from collections.abc import Callable

import pytest
from synthetic_logs import build_insertion_log, build_log

from sonoservo.systems.evaluation import RunLog


@pytest.fixture
def make_log() -> Callable[..., RunLog]:
    return build_log


@pytest.fixture
def insertion_log() -> RunLog:
    return build_insertion_log()
