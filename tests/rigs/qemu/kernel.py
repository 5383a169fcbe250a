"""The guest's kernel: Debian's own package, fetched once, and the modules that the rig needs."""

from __future__ import annotations

import gzip
import lzma
import re
import shutil
import subprocess
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
CHECKOUT = HERE.parents[2]
CACHE = CHECKOUT / ".cache" / "qemu"
META_PACKAGE = "linux-image-amd64"
MODULES = (
    *("virtio_pci", "9p", "9pnet_virtio", "overlay"),
    *("dummy_hcd", "usb_f_acm", "usb_f_fs", "cdc-acm"),
)
OPTIONS = {"dummy_hcd.ko": "num=2"}  # two sockets: another device may be plugged in beside
APT = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "modprobe": "kmod",
    "dpkg-deb": "dpkg",
    "apt-get": "apt",
}
FETCH_TIMEOUT_S = 120


class NoGuest(Exception):
    """The guest cannot be made here; the message says what to install."""


@dataclass(frozen=True)
class Kernel:
    """A kernel image and its modules; the file ``order`` says how to insert them."""

    image: Path
    modules: Path


def require_tools() -> None:
    """Raise ``NoGuest`` with the apt line, if a tool is missing."""
    missing = [package for tool, package in APT.items() if _find(tool) is None]
    if missing:
        raise NoGuest(f"rig C needs {', '.join(missing)}: apt-get install {' '.join(missing)}")
    with _tool("busybox").open("rb") as file:
        # The initramfs has no libraries: a dynamic busybox ends in a kernel panic.
        if b"/ld-linux" in file.read(4096):
            raise NoGuest("rig C needs a static busybox: apt-get install busybox-static")


def get_kernel() -> Kernel:
    """Return the cached kernel, or fetch Debian's with apt-get."""
    for order in sorted(CACHE.glob(f"*{_kind()}/modules/order"), reverse=True):
        return Kernel(order.parents[1] / "vmlinuz", order.parent)
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
        return _unpack(_download(Path(scratch)), Path(scratch))


def _kind() -> str:
    """Ends a cached kernel's name: one with other modules is another one."""
    return f"-{zlib.crc32(repr((MODULES, OPTIONS)).encode()):08x}"


def make_initramfs(kernel: Kernel, init: Path, job: str, out: Path) -> None:
    """Write the initramfs whose PID 1 is ``init``, which runs the shell script ``job``."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        for folder in ("bin", "dev", "proc", "sys", "host"):
            (root / folder).mkdir()
        shutil.copy(_tool("busybox"), root / "bin" / "busybox")
        shutil.copytree(kernel.modules, root / "modules")
        (root / "job").write_text(job)
        shutil.copy(init, root / "init")
        (root / "init").chmod(0o755)
        names = "\n".join(str(path.relative_to(root)) for path in sorted(root.rglob("*")))
        archive = subprocess.run(
            [_tool("cpio"), "-o", "-H", "newc", "--quiet"],
            input=names.encode(),
            cwd=root,
            check=True,
            capture_output=True,
        ).stdout
    out.write_bytes(gzip.compress(archive, 1))


def _download(scratch: Path) -> Path:
    # The meta package only names the image of the day.
    listing = _run(["apt-cache", "depends", META_PACKAGE], scratch)
    names = [line.split()[-1] for line in listing.splitlines() if "Depends: linux-image-" in line]
    if not names:
        raise NoGuest(f"apt knows no {META_PACKAGE}: needs Debian's lists, apt-get update")
    _run(["apt-get", "download", names[0]], scratch)
    return next(scratch.glob("*.deb"))


def _unpack(package: Path, scratch: Path) -> Kernel:
    root = scratch / "root"
    _run(["dpkg-deb", "-x", str(package), str(root)], scratch)
    (image,) = (root / "boot").glob("vmlinuz-*")
    version = image.name.removeprefix("vmlinuz-")
    if not (root / "lib").exists():
        (root / "lib").symlink_to("usr/lib")
    _run([str(_tool("depmod")), "-b", str(root), version], scratch)
    made = scratch / "made"
    (made / "modules").mkdir(parents=True)
    shutil.copy(image, made / "vmlinuz")
    order: dict[str, None] = {}
    for module in MODULES:
        search = [str(_tool("modprobe")), "-d", str(root), "-S", version, "--show-depends", module]
        for line in _run(search, scratch).splitlines():
            # The checkout's path may hold spaces; options may follow.
            if found := re.match(r"insmod (.+\.ko(\.\w+)?)", line):
                order[_copy_module(Path(found[1]), made / "modules")] = None
    lines = [f"{name} {OPTIONS.get(name, '')}\n" for name in order]
    (made / "modules" / "order").write_text("".join(lines))
    final = CACHE / (version + _kind())
    made.rename(final)
    return Kernel(final / "vmlinuz", final / "modules")


def _copy_module(module: Path, folder: Path) -> str:
    data = module.read_bytes()
    if module.suffix == ".xz":  # Debian 13 compresses them, which busybox cannot load
        module, data = module.with_suffix(""), lzma.decompress(data)
    (folder / module.name).write_bytes(data)
    return module.name


def _run(command: list[str], folder: Path) -> str:
    try:
        result = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=FETCH_TIMEOUT_S
        )
    except subprocess.TimeoutExpired as error:
        raise NoGuest(f"{' '.join(command)}: not done in {FETCH_TIMEOUT_S} s") from error
    if result.returncode:
        raise NoGuest(
            f"{' '.join(command)} failed: {result.stderr.strip()[-300:]} (apt-get update?)"
        )
    return result.stdout


def _find(tool: str) -> Path | None:
    # Users have no sbin in their PATH, where Debian keeps kmod's tools.
    found = shutil.which(tool) or shutil.which(tool, path="/usr/sbin:/sbin:/usr/bin:/bin")
    return Path(found) if found else None


def _tool(tool: str) -> Path:
    found = _find(tool)
    if found is None:
        raise NoGuest(f"no {tool}: apt-get install {APT.get(tool, tool)}")
    return found
