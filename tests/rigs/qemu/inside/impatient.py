"""A program that reads a frame from a FunctionFS board 100 bytes at a time: says what it meets."""

from __future__ import annotations

import errno

import usb.core
import usb.util

from qemu.inside.gadget import PRODUCT_ID, VENDOR_ID


def main() -> None:
    """Print the name of the error, or how many bytes came."""
    device = usb.core.find(idVendor=VENDOR_ID, idProduct=PRODUCT_ID)
    data = device.get_active_configuration()[1, 0]
    # The gadget framework numbers endpoints as it likes.
    ends = {usb.util.endpoint_direction(end.bEndpointAddress): end for end in data}
    ends[usb.util.ENDPOINT_OUT].write(b"!A,1,0,0\n")
    try:
        print(f"{len(ends[usb.util.ENDPOINT_IN].read(100))} bytes")
    except usb.core.USBError as error:
        print(errno.errorcode[error.errno])


if __name__ == "__main__":
    main()
