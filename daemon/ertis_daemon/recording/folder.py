"""The folder that a sonar's recordings go to, in bounded size."""

from __future__ import annotations

import logging
import os
import re
import time
from pathlib import Path

from ertis_driver.errors import ErtisError

log = logging.getLogger(__name__)

MEGABYTE = 1_000_000


class NoRoom(ErtisError):
    """Nothing can be recorded: give the folder more room, or name another one."""


def state_folder() -> Path:
    """Where a service keeps its own: systemd's StateDirectory, or the user's.

    Raises
    ------
    NoRoom
        If neither is known.
    """
    for name, rest in (("STATE_DIRECTORY", ""), ("XDG_STATE_HOME", "ertis"), ("HOME", "")):
        value = os.environ.get(name, "").split(":")[0]
        if value:
            return Path(value) / (".local/state/ertis" if name == "HOME" else rest)
    raise NoRoom("no folder for recordings: name one as record.folder")


class RecordingFolder:
    """Names new recordings of one sonar and removes its oldest ones.

    Parameters
    ----------
    path
        Made when it is needed; empty for the service's state folder.
    name
        The sonar's. Files of other names are left alone.
    max_bytes
        Of this sonar's recordings together.
    keep_free_bytes
        What is left free of the disk.
    """

    def __init__(self, path: str, name: str, max_bytes: int, keep_free_bytes: int) -> None:
        self._path = path
        self._name = name
        self._max_bytes = max_bytes
        self._keep_free_bytes = keep_free_bytes
        self._ours = re.compile(re.escape(name) + r"-\d{8}T\d{6}\.\d{3}Z-[\w-]+\.mcap")

    def new_path(self, reason: str) -> Path:
        """Name a recording: sonar, UTC time and why; the disk is left alone.

        Raises
        ------
        NoRoom
            If no folder is known.
        """
        folder = Path(self._path) if self._path else state_folder()
        now_s = time.time()
        stamp = (
            time.strftime("%Y%m%dT%H%M%S", time.gmtime(now_s)) + f".{int(now_s * 1e3) % 1000:03d}Z"
        )
        return folder / f"{self._name}-{stamp}-{reason}.mcap"

    def make_room(self, path: Path, num_bytes: int) -> None:
        """Remove this sonar's oldest recordings until ``num_bytes`` more fit beside ``path``.

        None goes if all of them would not do. The folder is made if it is not there. All of this
        may take as long as a network's disk takes to answer.

        Raises
        ------
        NoRoom
            If they do not fit even so, or the folder cannot be made.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise NoRoom(
                f"cannot make {path.parent}: {error.strerror}; see record.folder"
            ) from error
        try:
            self._make_room(path, num_bytes)
        except OSError as error:
            raise NoRoom(f"{path.parent}: {error.strerror}") from error

    def _make_room(self, path: Path, num_bytes: int) -> None:
        sizes = {
            file: file.stat().st_size
            for file in sorted(path.parent.iterdir())  # by name is by time
            if self._ours.fullmatch(file.name)
        }
        needed = sizes.pop(path, 0) + num_bytes  # not the newest by name if the clock was set back
        if needed > self._max_bytes:
            raise NoRoom(
                f"{path.parent}: this recording may need {-(-needed // MEGABYTE)} MB, "
                f"record.folder_mb allows {self._max_bytes // MEGABYTE}"
            )
        disk = os.statvfs(path.parent)
        free = disk.f_bavail * disk.f_frsize - self._keep_free_bytes
        total = sum(sizes.values()) + needed
        removed = []
        for file, size in sizes.items():
            if total <= self._max_bytes and free >= num_bytes:
                break
            removed.append(file)
            total, free = total - size, free + size
        if free < num_bytes:
            raise NoRoom(
                f"{path.parent}: this recording may need {-(-num_bytes // MEGABYTE)} MB; even with "
                f"{self._name}'s older ones gone, the disk would have less than "
                f"{self._keep_free_bytes // MEGABYTE} MB free (record.keep_free_mb)"
            )
        for file in removed:
            log.info("%s is removed, to make room", file)
            file.unlink(missing_ok=True)
