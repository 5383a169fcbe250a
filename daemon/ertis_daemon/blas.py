"""How numpy's products are computed: settled by the environment, before numpy is first imported."""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from pathlib import Path

# Skylake-X and Cascade Lake: after products of 512 bits the whole core is clocked a tenth lower
# for a while, and all else that a ping needs takes that much longer.
_SLOWED_BY_WIDE_PRODUCTS = ("cpu family\t: 6", "model\t\t: 85")


def settle_blas(
    environment: MutableMapping[str, str] = os.environ, cpuinfo: Path = Path("/proc/cpuinfo")
) -> None:
    """Set what is not set yet: one thread, and no products that slow the rest down.

    One ping's arrays are small: threads of BLAS cost more than they give, on a robot above all.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        environment.setdefault(name, "1")
    if _is_slowed_by_wide_products(cpuinfo):
        environment.setdefault("OPENBLAS_CORETYPE", "Haswell")  # 256 bits


def _is_slowed_by_wide_products(cpuinfo: Path) -> bool:
    try:
        told = cpuinfo.read_text(errors="replace").splitlines()
    except OSError:  # not Linux, or hidden
        return False
    return all(line in told for line in _SLOWED_BY_WIDE_PRODUCTS)
