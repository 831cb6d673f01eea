"""Clusters by a text: address of a scheduler, processes of this machine, or file of a job queue."""

import inspect
import logging
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonoservo.diagrams.studies.processes import THREADS, keeping_ctrl_c
from sonoservo.systems.files.refusals import ConfigurationError, describe
from sonoservo.systems.files.typed_yaml import read_yaml, suggest

if TYPE_CHECKING:
    from distributed import LocalCluster

    from sonoservo.diagrams.studies.cluster.cluster import Cluster

CASE_LIMIT_S = 3600.0  # longest time in s that a case may take, unless another one is given

_LOCAL = "local:"
_CONNECT_S = 15.0


@contextmanager
def open_cluster(
    text: str, *, limit: float = CASE_LIMIT_S, notify: Callable[[str], None] = print
) -> Iterator["Cluster"]:
    """Open a cluster of Dask distributed for the cases of studies.

    Parameters
    ----------
    text
        ``tcp://host:8786``, the address of a scheduler; ``local:4``, four processes of this
        machine; or the path of a YAML file that names a class of dask-jobqueue
        (`read_job_queue`).
    limit
        Longest time in s that a case may take.
    notify
        Function that shows a line of text, such as the address of the dashboard.

    Yields
    ------
    The cluster, for `run_cases`. Workers that were started for it end with the block.

    Raises
    ------
    ConfigurationError
        If Dask is missing, the text has another form, the file is wrong, or no scheduler answers.
    """
    if not limit > 0:
        raise ConfigurationError(f"case limit: {limit:g} is not allowed; it must be above 0 s")
    try:
        from distributed import Client

        from sonoservo.diagrams.studies.cluster.cluster import Cluster
    except ImportError as error:
        raise ConfigurationError(
            f"cluster: {text}: install Dask first: pip install -e '.[cluster]' ({error.name})"
        ) from error
    # What Dask logs about lost connections is said in one line by this program.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with _scheduler(text) as scheduler:
        try:
            client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigurationError(
                f"cluster: {text}: no scheduler answers: {describe(error)}"
            ) from error
        with client:
            cluster = Cluster(client, limit=limit)
            notify(f"Dashboard of the cluster: {cluster.dashboard}")
            yield cluster


@contextmanager
def _scheduler(text: str) -> Iterator[object]:
    """Yield the address of a scheduler, or one of Dask's own clusters."""
    if text.startswith(("tcp://", "tls://")):
        yield text
    elif text.startswith(_LOCAL):
        count = text.removeprefix(_LOCAL)
        if not count.isdecimal() or not 1 <= int(count) <= 1024:
            raise ConfigurationError(
                f"cluster: {text}: {count!r} is not allowed; it must be a number from 1 to 1024"
            )
        with local_cluster(int(count)) as cluster:
            yield cluster
    elif text.endswith((".yaml", ".yml")):
        with read_job_queue(Path(text)).start() as cluster:
            yield cluster
    else:
        raise ConfigurationError(
            f"cluster: {text!r} is not allowed; it must be tcp://HOST:PORT, local:N or FILE.yaml"
        )


_CALM = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.work-stealing": False,
}
"""Settings with which Dask leaves cores and memory to the cases."""


@contextmanager
def local_cluster(cases: int) -> Iterator["LocalCluster"]:
    """Start a scheduler and a worker for each of a number of cases; they end with the block."""
    import dask
    from distributed import LocalCluster

    with dask.config.set(_CALM), keeping_ctrl_c():
        cluster = LocalCluster(
            n_workers=cases,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL + 1,
            env=dict.fromkeys(THREADS, "1"),
        )
    with dask.config.set(_CALM), cluster:
        yield cluster


_FIELDS = ("class", "jobs", "arguments")

_TYPES: Mapping[str, tuple[type, ...]] = {
    name: types
    for types, names in (
        ((int,), "cores processes job_cpu"),
        ((int, float), "death_timeout"),
        ((bool,), "nanny"),
        ((list,), "job_extra_directives job_directives_skip job_script_prologue worker_extra_args"),
        ((str,), "memory walltime queue account project interface protocol local_directory "
         "log_directory python shebang job_name job_mem resource_spec"),
    )
    for name in names.split()
}  # fmt: skip
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
