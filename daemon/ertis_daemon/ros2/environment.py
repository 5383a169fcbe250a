"""What ROS users set in the environment, read as rmw_zenoh reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import zenoh

from ertis_daemon.ros2.config import MAX_DOMAIN_ID
from ertis_daemon.zenoh_session import PublisherError

DOMAIN_ID = "ROS_DOMAIN_ID"
CONFIG_FILE = "ZENOH_SESSION_CONFIG_URI"
CONFIG_OVERRIDE = "ZENOH_CONFIG_OVERRIDE"


def domain_id(configured: int, environment: Mapping[str, str]) -> int:
    """Return the ROS domain: the configured one, else that of the environment, else 0.

    Raises
    ------
    PublisherError
        If ROS_DOMAIN_ID is no domain.
    """
    if configured >= 0:
        return configured
    text = environment.get(DOMAIN_ID, "").strip() or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= MAX_DOMAIN_ID):
        raise PublisherError(
            f"{DOMAIN_ID} is {text!r}, expected a number from 0 to {MAX_DOMAIN_ID}"
        )
    return int(text)


def session_config(configured: zenoh.Config, environment: Mapping[str, str]) -> zenoh.Config:
    """Return how to open the session: as configured, unless the environment says otherwise.

    ``ZENOH_SESSION_CONFIG_URI`` names a file to use instead; ``ZENOH_CONFIG_OVERRIDE``, a list
    ``key=value;key=value`` with values in JSON5, is applied last.

    Raises
    ------
    PublisherError
        If the file or a value is not understood, or time stamps are switched off.
    """
    config = configured
    path = environment.get(CONFIG_FILE, "").strip()
    if path:
        config = _from_file(Path(path.removeprefix("file://")))
    for pair in environment.get(CONFIG_OVERRIDE, "").split(";"):
        if pair.strip():
            _override(config, pair)
    if json.loads(config.get_json("timestamping")).get("enabled") is not True:
        raise PublisherError(
            f"Zenoh: timestamping is off in {path or CONFIG_OVERRIDE}, but late joiners need it: "
            "set timestamping: { enabled: true } there"
        )
    return config


def _from_file(path: Path) -> zenoh.Config:
    try:
        path.open("rb").close()  # Zenoh's own message names no reason
        config: zenoh.Config = zenoh.Config.from_file(str(path))
    except OSError as error:
        raise PublisherError(f"{CONFIG_FILE}: {path}: {error.strerror or error}") from error
    except zenoh.ZError as error:
        text = " ".join(str(error).split())
        raise PublisherError(f"{CONFIG_FILE}: {path}: {text}") from error
    return config


def _override(config: zenoh.Config, pair: str) -> None:
    key, equals, value = pair.partition("=")
    try:
        if not equals:
            raise PublisherError(f"{CONFIG_OVERRIDE}: {pair!r}, expected key=value;key=value")
        config.insert_json5(key.strip(), value.strip())
    except zenoh.ZError as error:
        text = " ".join(str(error).split())
        raise PublisherError(f"{CONFIG_OVERRIDE}: {pair!r}: {text}") from error
