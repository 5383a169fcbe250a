"""Stands in for the incumbent's C module, which is not public: its five calls, over pyserial."""

import numpy as np
import serial

PATIENCE_S = 20.0  # the real one waits for ever; a test should not

_port = None


def connect(port, baud):
    """Open the port."""
    global _port
    try:
        _port = serial.Serial(port, baud, timeout=PATIENCE_S)
    except serial.SerialException as error:
        raise ConnectionError(str(error)) from error


def flush():
    """Forget what has come and what was to go."""
    _port.reset_input_buffer()
    _port.reset_output_buffer()


def command(text, wait_for_reply):
    """Send a line as it is; return the reply word, if one is to be waited for."""
    _port.write(text.encode())
    return int.from_bytes(_read(4), "little") if wait_for_reply else None


def getdata(num_bytes):
    """Wait for so many bytes; uint8, shape (num_bytes,)."""
    return np.frombuffer(_read(num_bytes), np.uint8)


def close():
    """Give the port back."""
    global _port
    if _port is None:
        raise ConnectionRefusedError("not connected")
    _port.close()
    _port = None


def _read(num_bytes):
    data = _port.read(num_bytes)
    if len(data) != num_bytes:
        raise TimeoutError(f"{len(data)} bytes in {PATIENCE_S:g} s, expected {num_bytes}")
    return data
