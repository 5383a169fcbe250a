"""The methods that the strict protocol compares, by the name that the command line knows."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence

from ertis_detector.method import Method
from ertis_driver.errors import SettingsError

# name -> (module, what makes it without arguments); imported only when asked for.
METHODS: Mapping[str, tuple[str, str]] = {
    "paper": ("ertis_detector.paper", "PaperMethod"),
    "paper-kind": ("ertis_detector.paper", "kindest"),
    "peaks": ("ertis_detector.peak_method", "PeakMethod"),
    "ours": ("ertis_detector.known_range", "KnownRangeDetector"),
}


def build_methods(names: Sequence[str]) -> list[Method]:
    """Methods in the order of their names.

    Raises
    ------
    SettingsError
        If one does not exist, or is named twice.
    """
    for name in names:
        if name not in METHODS:
            raise SettingsError(f"no method {name!r}, expected some of {', '.join(METHODS)}")
    if len(set(names)) < len(names):
        raise SettingsError(f"methods {', '.join(names)}: each can be named once")
    return [
        getattr(importlib.import_module(module), maker)()
        for module, maker in (METHODS[name] for name in names)
    ]
