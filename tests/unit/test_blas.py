"""The environment that numpy's products are computed by."""

import pytest

from ertis_daemon.blas import settle_blas

SLOWED = "cpu:type:x86,ven0000fam0006mod0055:feature:,0000,0125,0130,0131\n"


@pytest.fixture
def processor(tmp_path):
    path = tmp_path / "modalias"
    path.write_text(SLOWED)
    return path


def test_one_thread_and_narrow_products_where_wide_ones_slow_the_core(processor):
    environment = {}
    settle_blas(environment, processor)
    assert environment == {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_CORETYPE": "Haswell",
    }


@pytest.mark.parametrize(
    "told",
    [
        SLOWED.replace("mod0055", "mod006A"),
        SLOWED.replace(",0130", ""),
        "cpu:type:aarch64:feature:,0000",
        "",
    ],
)
def test_other_processors_keep_the_kernels_that_blas_chooses(processor, told):
    processor.write_text(told)
    environment = {}
    settle_blas(environment, processor)
    assert "OPENBLAS_CORETYPE" not in environment


def test_a_processor_without_a_name_is_no_fault(tmp_path):
    environment = {}
    settle_blas(environment, tmp_path / "missing")
    assert environment["OPENBLAS_NUM_THREADS"] == "1"


def test_what_the_user_set_stays(processor):
    environment = {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "SkylakeX"}
    settle_blas(environment, processor)
    assert environment["OPENBLAS_NUM_THREADS"] == "2"
    assert environment["OPENBLAS_CORETYPE"] == "SkylakeX"
