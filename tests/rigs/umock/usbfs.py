"""A CDC-ACM device on usbfs: what the kernel would answer to libusb's ioctls.

Runs under the system's python, which has gi and umockdev. The bytes are not made here: they come
from the firmware emulator's pty. The model is libusb's own tests/umockdev.c.
"""

import contextlib
import errno
import os
import struct
import termios
import tty

import gi

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402

PACKET = 512
WRITE, READ, BOTH, NONE = 1, 2, 3, 0


def ioc(direction, number, size):
    return direction << 30 | size << 16 | ord("U") << 8 | number


GET_DRIVER = ioc(WRITE, 8, 260)
SUBMIT, DISCARD = ioc(READ, 10, 56), ioc(NONE, 11, 0)
REAP, REAP_NO_DELAY = ioc(WRITE, 12, 8), ioc(WRITE, 13, 8)
CLAIM, RELEASE = ioc(READ, 15, 4), ioc(READ, 16, 4)
DRIVER_IOCTL, DISCONNECT, CONNECT = ioc(BOTH, 18, 16), ioc(NONE, 22, 0), ioc(NONE, 23, 0)
CLEAR_HALT, CAPABILITIES = ioc(READ, 21, 4), ioc(READ, 26, 4)
CAPABILITY_BITS = 0x1F  # all that a 6.1 kernel has: one URB for a transfer of any length
CONTROL = 2  # URB type; what is not, is bulk
REAP_PAUSE_MS = 20
BREAKS = {"babble": errno.EOVERFLOW, "eproto": errno.EPROTO, "unplug": errno.ESHUTDOWN}


class CdcAcm(UMockdev.IoctlBase):
    """One device. ``fault`` happens in frame ``fault_ping`` after ``fault_at`` bytes of it."""

    def __init__(self, port, fault, unplug):
        super().__init__()
        self.fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.fd)
        self.fault, self.unplug = fault, unplug
        self.log = []
        self.drivers = {0: "cdc_acm", 1: "cdc_acm"}
        self.claims = set()
        self.out = bytearray()  # what the device wants to send
        self.pending, self.done = [], []  # URBs: [urb, buffer, length, filled]
        self.pings = -1
        self.sent_of_frame = 0
        self.gone = self.halted = False
        self.tty = self.tty_watch = -1
        self.waiting = None
        GLib.io_add_watch(self.fd, GLib.IOCondition.IN, self.receive)

    def receive(self, *_):
        if self.gone:
            return False
        with contextlib.suppress(BlockingIOError):
            self.out += os.read(self.fd, 65536)
        if self.drivers:
            self.fill_tty()
        else:
            self.wake()
        return True

    def serve_tty(self, fd):
        """Be what the kernel's driver makes of it, as long as that is not detached."""
        self.tty = fd
        os.set_blocking(fd, False)
        self.tty_watch = GLib.io_add_watch(fd, GLib.IOCondition.IN, self.receive_tty)

    def receive_tty(self, *_):
        with contextlib.suppress(BlockingIOError):
            self.take(os.read(self.tty, 4096))
        return True

    def fill_tty(self):
        while self.out and not self.gone:
            left = self.due(len(self.out))
            try:
                count = os.write(self.tty, self.out if left is None else self.out[:left])
            except BlockingIOError:
                GLib.timeout_add(1, self.fill_tty)  # nobody reads yet
                return False
            del self.out[:count]
            self.sent_of_frame += count
            if count == left:
                self.log.append(["fault", "unplug"])
                self.vanish()
        return False

    def vanish(self):
        self.gone = True
        GLib.source_remove(self.tty_watch)
        os.close(self.tty)  # hangs up
        self.unplug()

    def do_handle_ioctl(self, client):
        # umockdev asks in a thread of its own. Bytes and timers come in the main loop's: were both
        # at work, a timer could run out before reap() noted whom it is for, and libusb would wait
        # for ever.
        GLib.idle_add(self.handle, client, priority=GLib.PRIORITY_DEFAULT)
        return True

    def handle(self, client):
        request, arg = client.get_request() & 0xFFFFFFFF, client.get_arg()
        if request in (REAP, REAP_NO_DELAY):
            self.reap(client, arg)
            return False
        try:
            if self.gone and request != DISCARD:
                raise OSError(errno.ENODEV, "gone")
            client.complete(self.answer(request, arg), 0)
        except OSError as error:
            client.complete(-1, error.errno)
        return False

    def answer(self, request, arg):
        if request == CAPABILITIES:
            arg.resolve(0, 4).update(0, struct.pack("<I", CAPABILITY_BITS))
        elif request == GET_DRIVER:
            self.get_driver(arg.resolve(0, 260))
        elif request == DRIVER_IOCTL:
            return self.driver_ioctl(arg.resolve(0, 16))
        elif request in (CLAIM, RELEASE):
            self.claim(request, number(arg.resolve(0, 4)))
        elif request == CLEAR_HALT:
            self.log.append(["clear_halt", number(arg.resolve(0, 4))])
            self.halted = False
        elif request == SUBMIT:
            self.submit(arg.resolve(0, 56))
        elif request == DISCARD:
            if not self.pending:
                raise OSError(errno.EINVAL, "nothing to discard")
            self.finish(errno.ENOENT)
        else:
            raise OSError(errno.ENOTTY, hex(request))
        return 0

    def get_driver(self, data):
        driver = self.drivers.get(number(data))
        if driver is None:
            raise OSError(errno.ENODATA, "no driver")
        data.update(4, driver.encode() + b"\0")

    def driver_ioctl(self, data):
        interface, code = struct.unpack_from("<iI", bytes(data.retrieve()))
        if code == DISCONNECT:
            if interface not in self.drivers:
                raise OSError(errno.ENODATA, "no driver")
            self.drivers.clear()  # cdc-acm leaves both interfaces together
            self.log.append(["detach", interface])
            return 0
        if self.drivers:
            raise OSError(errno.EBUSY, "bound")
        self.drivers = {0: "cdc_acm", 1: "cdc_acm"}
        self.log.append(["attach", interface])
        return 1

    def claim(self, request, interface):
        if request == RELEASE:
            self.claims.discard(interface)
            self.log.append(["release", interface])
            return
        if self.fault["kind"] == "busy" or interface in self.drivers:
            raise OSError(errno.EBUSY, "claimed")
        self.claims.add(interface)
        self.log.append(["claim", interface])

    def submit(self, urb):
        raw = bytes(urb.retrieve())
        length = struct.unpack_from("<i", raw, 24)[0]
        buffer = urb.resolve(16, length)
        if raw[0] == CONTROL:
            data = bytes(buffer.retrieve())
            self.log.append(["control", data.hex()])
            self.end(urb, errno.EPIPE if self.fault["kind"] == "no_line" else 0, length - 8)
        elif raw[1] & 0x80:
            if 1 not in self.claims:
                raise OSError(errno.EPERM, "not claimed")
            self.pending.append([urb, buffer, length, 0])
        else:
            self.take(bytes(buffer.retrieve()))
            self.end(urb, 0, length)

    def take(self, data):
        if self.fault["kind"] == "stopped":
            self.fault = {"kind": "none"}
            self.out.clear()
        if data.startswith(b"!A"):
            self.pings += 1
            self.sent_of_frame = 0
        os.write(self.fd, data)

    def end(self, urb, code, count):
        urb.update(28, struct.pack("<i", count))
        self.done.append((urb, -code))

    def finish(self, code):
        urb, _, _, filled = self.pending.pop(0)
        self.end(urb, code, filled)

    def due(self, count):
        """How many of ``count`` bytes still go before the fault, None if it is not due."""
        fault = self.fault
        if fault["kind"] in ("none", "busy", "no_line", "stopped") or self.pings != fault["ping"]:
            return None
        left = fault["at"] - self.sent_of_frame
        return left if left <= count else None

    def fill(self):
        """Move bytes into URBs, which end when they are full or with a short packet.

        Only while libusb waits for an ioctl's answer: writing into its memory runs the main loop.
        """
        while self.pending:
            if self.halted:
                self.finish(errno.EPIPE)
                continue
            urb = self.pending[0]
            if self.fault["kind"] == "stopped":
                return
            count = min(urb[2] - urb[3], len(self.out))
            left = self.due(count)
            count = count if left is None else left
            if count:
                urb[1].update(urb[3], bytes(self.out[:count]))
                del self.out[:count]
                urb[3] += count
                self.sent_of_frame += count
            if left is not None:
                self.break_()
            elif urb[3] == urb[2] or urb[3] % PACKET:
                self.finish(0)
            else:
                return

    def break_(self):
        kind, self.fault = self.fault["kind"], {**self.fault, "kind": "none"}
        self.log.append(["fault", kind])
        if kind == "short":
            self.finish(0)
        elif kind == "stop":  # the device hangs: nothing before the next command
            self.fault = {**self.fault, "kind": "stopped"}
        elif kind == "stall":
            self.out.clear()
            self.halted = True
        else:
            self.finish(BREAKS[kind])
            if kind == "unplug":
                self.vanish()

    def reap(self, client, arg):
        self.fill()
        if self.answer_reap(client, arg):
            return
        if self.pending:
            # umockdev's file is always ready: without a pause libusb would spin.
            self.waiting = client, arg, GLib.timeout_add(REAP_PAUSE_MS, self.wake)
        else:
            client.complete(-1, errno.EAGAIN)

    def wake(self):
        if self.waiting is not None:
            (client, arg, timer), self.waiting = self.waiting, None
            GLib.source_remove(timer)  # also under the timer itself
            self.fill()
            if not self.answer_reap(client, arg):
                client.complete(-1, errno.EAGAIN)
        return False

    def answer_reap(self, client, arg):
        if self.done:
            urb, status = self.done.pop(0)
            urb.update(4, struct.pack("<i", status))
            arg.resolve(0, 8).set_ptr(0, urb)
            client.complete(0, 0)
        elif self.gone:
            client.complete(-1, errno.ENODEV)
        else:
            return False
        return True


class TtyIoctls(UMockdev.IoctlBase):
    """Beside it there is a pty, but umockdev keeps ioctls from it: these have no effect here."""

    def do_handle_ioctl(self, client):
        known = client.get_request() & 0xFFFFFFFF in (termios.TIOCEXCL, termios.TIOCNXCL)
        client.complete(0 if known else -1, 0 if known else errno.ENOTTY)
        return True


def number(data):
    return struct.unpack_from("<I", bytes(data.retrieve()))[0]
