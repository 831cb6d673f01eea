"""Clusters of a batch system such as Slurm, from a YAML file, with dask-jobqueue."""

import inspect
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sonoservo.systems.files.refusals import ConfigurationError, describe
from sonoservo.systems.files.typed_yaml import read_yaml, suggest

_FIELDS = ("class", "jobs", "arguments")

_TEXT, _LINES = (str,), (list,)
_TYPES: Mapping[str, tuple[type, ...]] = {
    "cores": (int,),
    "processes": (int,),
    "memory": _TEXT,
    "walltime": _TEXT,
    "queue": _TEXT,
    "account": _TEXT,
    "project": _TEXT,
    "interface": _TEXT,
    "protocol": _TEXT,
    "local_directory": _TEXT,
    "log_directory": _TEXT,
    "python": _TEXT,
    "shebang": _TEXT,
    "job_name": _TEXT,
    "job_mem": _TEXT,
    "resource_spec": _TEXT,
    "job_cpu": (int,),
    "death_timeout": (int, float),
    "nanny": (bool,),
    "job_extra_directives": _LINES,
    "job_directives_skip": _LINES,
    "job_script_prologue": _LINES,
    "worker_extra_args": _LINES,
}
"""Types of the arguments that most classes of dask-jobqueue have; they do not declare any."""

_KIND = {int: "a whole number", float: "a number", str: "text", bool: "true or false"}
_KIND[list] = "a list of lines of text"


@dataclass(frozen=True)
class JobQueue:
    """Jobs of a batch system that serve as workers: class of dask-jobqueue, and its arguments."""

    kind: type
    jobs: int = 1
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def start(self) -> Any:
        """Ask for the jobs, and return dask-jobqueue's cluster."""
        try:
            cluster = self.kind(**self.arguments)
            cluster.scale(jobs=self.jobs)
        except (ValueError, TypeError, OSError, RuntimeError) as error:
            raise ConfigurationError(f"cluster: {self.kind.__name__}: {describe(error)}") from error
        return cluster


def read_job_queue(path: Path) -> JobQueue:
    """Read the fields ``class``, ``jobs`` and ``arguments`` of a YAML file for dask-jobqueue."""
    try:
        with _keeping_handler_of_ctrl_c():
            import dask_jobqueue
            from dask_jobqueue.local import LocalCluster
    except ImportError as error:
        raise ConfigurationError(
            f"{path}: install dask-jobqueue first: pip install -e '.[cluster]'"
        ) from error
    data = read_yaml(path)
    for name in data:
        if name not in _FIELDS:
            raise ConfigurationError(f"{path}: {name}: unknown field; {suggest(name, _FIELDS)}")
    known = {
        name: each
        for name, each in vars(dask_jobqueue).items()
        if name.endswith("Cluster") and name != "JobQueueCluster"
    }
    known["LocalCluster"] = LocalCluster  # for trials: its jobs run on this machine
    kind = data.get("class")
    if not isinstance(kind, str) or kind not in known:
        raise ConfigurationError(
            f"{path}: class: {kind!r} is not allowed; {suggest(str(kind), known)}"
        )
    jobs = data.get("jobs", 1)
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise ConfigurationError(f"{path}: jobs: {jobs!r} is not allowed; expected 1 or more")
    arguments = data.get("arguments") or {}
    if not isinstance(arguments, Mapping):
        raise ConfigurationError(
            f"{path}: arguments: {arguments!r} is not allowed; expected a mapping"
        )
    names = _argument_names(known[kind])
    for name, value in arguments.items():
        if name not in names:
            raise ConfigurationError(
                f"{path}: arguments.{name}: unknown argument of {kind}; {suggest(name, names)}"
            )
        _check(f"{path}: arguments.{name}", value, _TYPES.get(name, (bool, int, float, str, list)))
    return JobQueue(known[kind], jobs, dict(arguments))


@contextmanager
def _keeping_handler_of_ctrl_c() -> Iterator[None]:
    """Undo that dask-jobqueue installs a handler of SIGINT on import."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


def _argument_names(kind: Any) -> set[str]:
    """Return the names of the arguments of a class of dask-jobqueue, and of its jobs."""
    classes = [*kind.__mro__, *kind.job_cls.__mro__]
    signatures = [inspect.signature(each.__init__) for each in classes if each is not object]
    names = {
        parameter.name
        for signature in signatures
        for parameter in signature.parameters.values()
        if parameter.kind is not parameter.VAR_KEYWORD
    }
    return names - {"self", "args", "kwargs", "job_cls", "loop", "asynchronous", "n_workers"}


def _check(path: str, value: Any, types: tuple[type, ...]) -> None:
    right = type(value) in types
    if right and isinstance(value, list):
        right = all(isinstance(line, str) for line in value)
    if right and isinstance(value, int | float) and not isinstance(value, bool):
        right = value > 0
    if not right:
        allowed = " or ".join(_KIND[each] for each in types)
        positive = ", above 0" if int in types or float in types else ""
        raise ConfigurationError(f"{path}: {value!r} is not allowed; expected {allowed}{positive}")
