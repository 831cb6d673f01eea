"""The error of a user's mistake, and the boundaries at which any failure becomes one."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

MAX_MESSAGE = 300
"""Largest length of a message to a person, in characters."""


class ConfigurationError(ValueError):
    """User error in a file or on the command line; its message needs no traceback.

    The message is a single line. The middle of a message of more than `MAX_MESSAGE` characters is
    left out.
    """

    def __init__(self, message: str) -> None:
        super().__init__(shorten(message))


def shorten(message: str) -> str:
    """Return a message on one line, printable, with at most `MAX_MESSAGE` characters."""
    line = " ".join(message[: 100 * MAX_MESSAGE].split())
    line = "".join(each if each.isprintable() else "\N{REPLACEMENT CHARACTER}" for each in line)
    if len(line) <= MAX_MESSAGE:
        return line
    half = (MAX_MESSAGE - 5) // 2
    first, last = line[:half], line[-half:]
    first, last = first.rpartition(" ")[0] or first, last.partition(" ")[2] or last  # whole words
    return f"{first} ... {last}"


def describe(error: BaseException) -> str:
    """Return the message of any error on one line; the name of its class if it has none."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    # pybind11's message on a wrong type ends with the values. Its signatures do not help users.
    text = str(error).rpartition("Invoked with: ")[2]
    return shorten(text.rpartition("Traceback")[0] or text) or type(error).__name__


@contextmanager
def refusing_failures(source: object, what: str = "") -> Iterator[None]:
    """Turn any failure inside into a ConfigurationError that begins with the source and ``what``.

    It is the boundary around data from outside, where any failure is a fault of the data. A
    ConfigurationError names its own source and is left as it is.
    """
    try:
        yield
    except ConfigurationError:
        raise
    except (Exception, SystemExit) as error:  # data may be code, and code may call sys.exit
        prefix = f"{source}: {what}: " if what else f"{source}: "
        name = "" if isinstance(error, Exception) else f"{type(error).__name__}: "
        raise ConfigurationError(f"{prefix}{name}{describe(error)}") from error


def require_extra(module: str, extra: str, source: object) -> ModuleType:
    """Return a module of an optional package, or name the extra that brings it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"{source}: this needs the package {module.partition('.')[0]}; install it with "
            f"pip install 'sonoservo[{extra}]'"
        ) from error
