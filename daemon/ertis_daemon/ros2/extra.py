"""Whether what ROS messages need is installed."""

from __future__ import annotations

import importlib

from ertis_driver.errors import ErtisError

NEEDED = ("rosbags.typesys", "xxhash")


class Ros2NotInstalled(ErtisError):
    """ROS 2 is switched on, but not installed: install the extra, or switch it off."""


def require() -> None:
    """Import what the rest of this package needs.

    Raises
    ------
    Ros2NotInstalled
        If it is not there.
    """
    for name in NEEDED:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise Ros2NotInstalled(
                f"ros2.enabled is set, but {name.partition('.')[0]} is not installed: "
                "pip install 'ertis[ros2]'"
            ) from error
