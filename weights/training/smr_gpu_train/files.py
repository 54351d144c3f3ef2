"""Files that are written whole or not at all, and folders that one process at a time works in."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from .errors import Unwritable


@contextlib.contextmanager
def whole(file: Path, *errors: type[Exception]) -> Iterator[Path]:
    """The path to write to, which becomes `file` in the end; what goes wrong, of `errors` too, becomes `Unwritable`."""
    # Of this process alone: several may write the same file.
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(file)
    except BaseException as error:
        if not isinstance(error, (OSError, *errors)):
            raise
        said = error.strerror if isinstance(error, OSError) and error.strerror else (str(error).splitlines() or [type(error).__name__])[0]
        raise Unwritable(f"{file}: cannot be written: {said}") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Whether this process has the folder; the lock goes with the process, however that ends. Where the system has no such lock, it has."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = open(folder / "lock", "w")
    except OSError as error:
        raise Unwritable(f"{folder}: cannot be written: {error.strerror}") from None
    with file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass
        except BlockingIOError:
            yield False
            return
        yield True
