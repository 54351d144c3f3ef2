"""What ends a command, told in a line."""

from collections.abc import Sequence


class Failure(Exception):
    """A mistake of the user's, or of the files that were given: exit status 2."""

    status = 2


class Unwritable(Failure):
    """An output that cannot be written: exit status 6, as the program's."""

    status = 6


class NotInstalled(Failure):
    """A library that is not there: exit status 1."""

    status = 1


NAMED = 3  # examples of each fault


def some(names: Sequence[object]) -> str:
    """The first few names, and how many more there are."""
    more = len(names) - NAMED
    return ", ".join(map(str, names[:NAMED])) + (f" and {more} more" if more > 0 else "")


def counted(count: int, thing: str, things: str | None = None) -> str:
    """`1 picture`, `2 pictures`."""
    return f"{count} {thing if count == 1 else things or thing + 's'}"
