"""Which version this is."""

from __future__ import annotations

from importlib import metadata


def version() -> str:
    """Return the installed version; empty if run from a source tree that is not installed."""
    try:
        return metadata.version("ertis")
    except metadata.PackageNotFoundError:
        return ""
