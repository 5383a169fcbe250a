"""A pty in front of a port: passes everything on, and keeps what the client sent."""

import os
import select
import threading
import tty

CHUNK_BYTES = 65_536


class Wiretap:
    """Clients open ``path`` instead of the port; ``sent`` is what they said. A context manager."""

    def __init__(self, port):
        self.sent = bytearray()
        self._device = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._device)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pass_on, name="wiretap")

    def _pass_on(self):
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master, self._device], [], [], 0.05)
            if self._master in ready:
                data = os.read(self._master, CHUNK_BYTES)
                self.sent += data
                _write_all(self._device, data)
            if self._device in ready:
                _write_all(self._master, os.read(self._device, CHUNK_BYTES))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        for descriptor in (self._slave, self._master, self._device):
            os.close(descriptor)


def _write_all(descriptor, data):
    while data:
        data = data[os.write(descriptor, data) :]
