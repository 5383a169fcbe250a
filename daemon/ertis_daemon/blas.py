"""How numpy's products are computed: settled by the environment, before numpy is first imported."""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from pathlib import Path

# What the kernel calls the processor; unlike /proc/cpuinfo a hardened service may read it.
_PROCESSOR = Path("/sys/devices/system/cpu/modalias")
# Intel's Skylake-X and Cascade Lake, and AVX512F: after products of 512 bits the whole core is
# clocked a tenth lower for a while, and all else that a ping needs takes that much longer.
_SLOWED_BY_WIDE_PRODUCTS = (",ven0000fam0006mod0055:", ",0130,")


def settle_blas(
    environment: MutableMapping[str, str] = os.environ, processor: Path = _PROCESSOR
) -> None:
    """Set what is not set yet: one thread, and no products that slow the rest down.

    One ping's arrays are small: threads of BLAS cost more than they give, on a robot above all.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        environment.setdefault(name, "1")
    if _is_slowed_by_wide_products(processor):
        environment.setdefault("OPENBLAS_CORETYPE", "Haswell")  # 256 bits


def _is_slowed_by_wide_products(processor: Path) -> bool:
    try:
        told = processor.read_text(errors="replace")
    except OSError:  # not Linux, or hidden
        return False
    return all(mark in told for mark in _SLOWED_BY_WIDE_PRODUCTS)
