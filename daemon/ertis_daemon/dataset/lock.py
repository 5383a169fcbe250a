"""One writer a data set: the second is told so."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ertis_driver.errors import DatasetError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the data set as its only writer; a crash lets go of it.

    Raises
    ------
    DatasetError
        If another process holds it, or the folder cannot be written.
    """
    path = folder / LOCK
    try:
        file = path.open("ab")
    except OSError as error:
        raise DatasetError(f"cannot write {path}: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DatasetError(
                f"{folder} is being written by another process: end that, then try again"
            ) from error
        yield
