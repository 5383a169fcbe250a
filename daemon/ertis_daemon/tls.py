"""Who the daemon is to a secured router: the three files that its certificate comes in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ertis_driver.errors import ErtisError

FILES = {
    "root_ca_certificate": "ca.pem",
    "connect_certificate": "cert.pem",
    "connect_private_key": "key.pem",
}


class TlsError(ErtisError):
    """The certificate cannot be used: see docs/security.md."""


def tls_values(folder: str, mode: str, connect: tuple[str, ...] | list[str]) -> dict[str, Any]:
    """Return what a Zenoh session needs to be told of the certificate in ``folder``.

    Raises
    ------
    TlsError
        If a file cannot be read; or if the session would also talk to others than a router over
        TLS, behind the back of the router's rules.
    """
    if mode != "client":
        raise TlsError(
            f"zenoh.tls is set, but zenoh.mode is {mode}: peers talk to each other past the "
            "router's rules; use mode client"
        )
    open_ways = [locator for locator in connect if not locator.startswith(("tls/", "quic/"))]
    if open_ways:
        raise TlsError(f"zenoh.tls is set, but {open_ways[0]} is not encrypted: use tls/HOST:PORT")
    for name in FILES.values():
        try:
            (Path(folder) / name).open("rb").close()
        except OSError as error:
            raise TlsError(f"zenoh.tls: {error.filename}: {error.strerror or error}") from error
    paths = {key: str(Path(folder) / name) for key, name in FILES.items()}
    return {**paths, "enable_mtls": True, "close_link_on_expiration": True}
