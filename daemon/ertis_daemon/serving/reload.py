"""What a new configuration changes of a running daemon."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.config import Config, SonarConfig
from ertis_driver.errors import ErtisError
from ertis_driver.open import is_hardware

if TYPE_CHECKING:
    from ertis_detector.detector import LandmarkDetector

WHOLE = ("zenoh", "ros2", "prometheus")  # sections that only a restart of the daemon takes


class ReloadError(ErtisError):
    """The new configuration is not taken, the old one goes on: correct it."""


@dataclass(frozen=True, slots=True)
class Changes:
    """From one configuration to another.

    added, changed : tuple of SonarConfig
        As they shall be.
    removed : tuple of str
        Names.
    said : tuple of str
        One line for each thing that is or is not taken.
    """

    added: tuple[SonarConfig, ...]
    changed: tuple[SonarConfig, ...]
    removed: tuple[str, ...]
    said: tuple[str, ...]


def compare(old: Config, new: Config) -> Changes:
    """What has to be done to get from one to the other."""
    before = {sonar.device.name: sonar for sonar in old.each_sonar()}
    after = {sonar.device.name: sonar for sonar in new.each_sonar()}
    added = tuple(sonar for name, sonar in after.items() if name not in before)
    changed = tuple(
        sonar for name, sonar in after.items() if name in before and sonar != before[name]
    )
    removed = tuple(name for name in before if name not in after)
    said = [f"{sonar.device.name}: added" for sonar in added]
    said += [f"{name}: removed" for name in removed]
    for sonar in changed:
        keys = ", ".join(_differing(before[sonar.device.name], sonar, ""))
        said.append(f"{sonar.device.name}: opened again, for {keys}")
    said += [
        f"{name}: changed, which needs a restart of the daemon"
        for name in WHOLE
        if getattr(old, name) != getattr(new, name)
    ]
    return Changes(added, changed, removed, tuple(said) or ("nothing has changed",))


def check_models(sonars: tuple[SonarConfig, ...]) -> None:
    """Look whether the models of these sonars can be loaded, before anything is stopped for them.

    Raises
    ------
    ReloadError
        If one cannot, or does not fit the chirp.
    """
    for sonar in sonars:
        load_detector(sonar)


def check_folders(sonars: tuple[SonarConfig, ...]) -> None:
    """Look whether nothing is in the place of the folders that recordings go to.

    Raises
    ------
    ReloadError
        If something is.
    """
    for sonar in sonars:
        met = _in_the_place_of(Path(sonar.record.folder))
        if met is not None:
            raise ReloadError(
                f"record.folder of sonar {sonar.device.name!r}: {met} is no folder: name another"
            )


def _in_the_place_of(folder: Path) -> Path | None:
    """What is where a folder, or one that it lies in, should be; None for nothing."""
    with suppress(OSError):  # what may not be looked at may still be there
        for path in (folder, *folder.parents):
            if path.exists():
                return None if path.is_dir() else path
    return None


def load_detector(sonar: SonarConfig) -> LandmarkDetector | None:
    """Load what a sonar is configured to detect with.

    Returns
    -------
    LandmarkDetector or None
        None for a recording, which has its own chirp; its model is only looked at.

    Raises
    ------
    ReloadError
        If the model cannot be loaded, or does not fit the chirp.
    """
    from ertis_daemon.pipeline import detector_for
    from ertis_detector.errors import DetectorError
    from ertis_detector.model import load_model

    try:
        if is_hardware(sonar.device.address):
            return detector_for(sonar, sonar.settings())
        if sonar.detector.model:
            load_model(Path(sonar.detector.model))
    except DetectorError as error:
        raise ReloadError(f"detector.model of sonar {sonar.device.name!r}: {error}") from error
    return None


def _differing(old: object, new: object, path: str) -> list[str]:
    names = []
    for spec in dataclasses.fields(old):  # type: ignore[arg-type]  # a section is a dataclass
        before, after = getattr(old, spec.name), getattr(new, spec.name)
        if dataclasses.is_dataclass(before):
            names += _differing(before, after, f"{path}{spec.name}.")
        elif before != after:
            names.append(path + spec.name)
    return names
