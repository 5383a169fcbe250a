"""The environment that numpy's products are computed by."""

import pytest

from ertis_daemon.blas import settle_blas

SLOWED = "cpu family\t: 6\nmodel\t\t: 85\nmodel name\t: Intel(R) Xeon(R)\n"


@pytest.fixture
def cpuinfo(tmp_path):
    path = tmp_path / "cpuinfo"
    path.write_text(SLOWED)
    return path


def test_one_thread_and_narrow_products_where_wide_ones_slow_the_core(cpuinfo):
    environment = {}
    settle_blas(environment, cpuinfo)
    assert environment == {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_CORETYPE": "Haswell",
    }


@pytest.mark.parametrize("told", [SLOWED.replace(": 85", ": 106"), "Model\t: Raspberry Pi 5\n", ""])
def test_other_processors_keep_the_kernels_that_blas_chooses(cpuinfo, told):
    cpuinfo.write_text(told)
    environment = {}
    settle_blas(environment, cpuinfo)
    assert "OPENBLAS_CORETYPE" not in environment


def test_no_cpuinfo_is_no_fault(tmp_path):
    environment = {}
    settle_blas(environment, tmp_path / "missing")
    assert environment["OPENBLAS_NUM_THREADS"] == "1"


def test_what_the_user_set_stays(cpuinfo):
    environment = {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "SkylakeX"}
    settle_blas(environment, cpuinfo)
    assert environment["OPENBLAS_NUM_THREADS"] == "2"
    assert environment["OPENBLAS_CORETYPE"] == "SkylakeX"
