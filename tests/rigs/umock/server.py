"""umockdev-wrapper python3 server.py SPEC.json: run a command that sees emulated USB devices.

SPEC: command, log (file), devices [{port, serial, product, fault}], fault {kind, at, ping,
replug_s, mode}.
"""

import faulthandler
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

from usbfs import CdcAcm, GLib, TtyIoctls, UMockdev

HANGS_S = 75  # after job.py has said where it is
DEVICE = bytes.fromhex("120100020200004083044057000201020301")
CONFIG = bytes.fromhex(
    "09024300020100803209040000010202010005240010010524010001042402020524060001"
    "07058203080010"
    "09040100020a0000000705010200020007058102000200"
)


class Rig:
    def __init__(self, spec):
        self.spec = spec
        self.bed = UMockdev.Testbed.new()
        self.devices = []
        self.address = 1
        self.ttys = 0
        for its in spec["devices"]:
            self.plug(its, its.get("fault") or {"kind": "none"})

    def plug(self, its, fault):
        self.address += 1
        # A tty that was held comes back under another name; so it does here, always.
        tty, self.ttys = self.ttys, self.ttys + 1
        place = 1 + self.spec["devices"].index(its)
        path = f"/devices/pci0000:00/usb1/1-{place}"
        node = f"/dev/bus/usb/001/{self.address:03d}"
        device = CdcAcm(its["port"], fault, lambda: self.unplug(its, fault, path, node))
        self.devices.append(device)
        self.bed.attach_ioctl(node, device)
        self.bed.attach_ioctl(f"/dev/ttyACM{tty}", TtyIoctls())
        self.bed.add_from_string(self.describe(its, path, node, place, tty))
        name = f"/dev/ttyACM{tty}"
        device.serve_tty(self.bed.get_dev_fd(name))
        # umockdev stumbles when the kernel gives the pty's number to another one: keep it taken.
        os.open(Path(self.bed.get_root_dir() + name).readlink(), os.O_RDWR | os.O_NOCTTY)
        if fault.get("mode") is not None:
            for name in (node, f"/dev/ttyACM{tty}"):
                Path(self.bed.get_root_dir() + name).chmod(fault["mode"])

    def describe(self, its, path, node, place, tty):
        usb = {
            "bConfigurationValue": "1",
            "bDeviceClass": "02",
            "bNumInterfaces": " 2",
            "busnum": "1",
            "devnum": str(self.address),
            "speed": "480",
            "idVendor": its.get("vendor", "0483"),
            "idProduct": "5740",
            "product": its["product"],
            "serial": its["serial"],
        }
        text = (
            f"P: {path}\nN: {node.removeprefix('/dev/')}\nE: SUBSYSTEM=usb\nE: DRIVER=usb\n"
            f"E: BUSNUM=001\nE: DEVNUM={self.address:03d}\nE: DEVNAME={node}\n"
            "E: DEVTYPE=usb_device\n"
        )
        text += "".join(f"A: {name}={value}\\n\n" for name, value in usb.items())
        vendor = bytes.fromhex(usb["idVendor"])[::-1]
        text += f"H: descriptors={(DEVICE[:8] + vendor + DEVICE[10:] + CONFIG).hex()}\n\n"
        text += (
            f"P: {path}/1-{place}:1.0\nE: SUBSYSTEM=usb\nE: DRIVER=cdc_acm\n"
            "E: DEVTYPE=usb_interface\nA: bInterfaceNumber=00\\n\nA: bInterfaceClass=02\\n\n\n"
            f"P: {path}/1-{place}:1.0/tty/ttyACM{tty}\nN: ttyACM{tty}\n"
            f"E: SUBSYSTEM=tty\nE: DEVNAME=/dev/ttyACM{tty}\nE: MAJOR=166\n"
            f"E: MINOR={tty}\nA: dev=166:{tty}\\n\nL: device=../../../1-{place}:1.0\n"
        )
        return text

    def unplug(self, its, fault, path, node):
        self.bed.detach_ioctl(node)
        for child in sorted(subfolders(self.bed.get_sys_dir() + path), key=len, reverse=True):
            self.bed.remove_device(child.replace(self.bed.get_sys_dir(), "/sys", 1))
        self.bed.remove_device("/sys" + path)
        if fault.get("replug_s") is not None:
            GLib.timeout_add(int(1000 * fault["replug_s"]), self.replug, its)

    def replug(self, its):
        self.plug(its, {"kind": "none"})
        return False


def subfolders(top):
    return [folder for folder, _, names in os.walk(top) if "uevent" in names and folder != top]


def main():
    spec = json.loads(Path(sys.argv[1]).read_text())
    rig = Rig(spec)
    loop = GLib.MainLoop()
    codes = []

    def run():
        codes.append(subprocess.call(spec["command"]))
        loop.quit()

    threading.Thread(target=run).start()
    loop.run()
    Path(spec["log"]).write_text(json.dumps([device.log for device in rig.devices]))
    sys.exit(codes[0])


faulthandler.dump_traceback_later(HANGS_S, exit=True)
main()
