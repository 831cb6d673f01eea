"""Numbers of things in words."""


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, which takes an s unless there is one."""
    return f"{number} {noun}{'s' * (number != 1)}"
