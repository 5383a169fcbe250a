"""The stored exact echoes of the dish: made again, taken apart, and held against other methods."""

from __future__ import annotations

import numpy as np
import pytest

from ertis_simulator.reference.arrivals import (
    BOUNCES,
    arrivals,
    fit_glints,
    ring_path,
    ring_strength,
)
from ertis_simulator.reference.compare import compare
from ertis_simulator.reference.meridian import CapMeridian
from ertis_simulator.reference.table import ReferenceTable, Views

SPHERE_RADIUS = CapMeridian.landmark().sphere_radius
SPEED_M_S = 343.0


@pytest.fixture(scope="module")
def table():
    return ReferenceTable.load()


def exact(table):
    """The stored values, as a method that gives exactly them."""

    def method(ka, views):
        first = int(np.searchsorted(table.ka, ka[0]))
        return table.amplitude[:, first : first + len(ka)].astype(np.complex128)

    return method


@pytest.mark.parametrize("ka", [8.0, 13.5, 32.0])
def test_the_stored_echoes_come_out_again(table, ka):
    column = table.amplitude[:, np.flatnonzero(table.ka == ka)[0]]
    again = table.views.amplitude(ka)
    assert np.abs(again - column).max() < 2e-5 * np.abs(column).max()


def test_a_table_comes_back_from_its_file(tmp_path):
    made = ReferenceTable.compute(np.array([2.0, 2.5]), Views.of([0.0, 0.3], 0.1, across=True))
    made.save(tmp_path / "small.npz")
    read = ReferenceTable.load(tmp_path / "small.npz")
    assert (read.amplitude == made.amplitude).all()
    assert (read.ka == made.ka).all()
    assert (read.views.azimuth_rad == made.views.azimuth_rad).all()
    assert np.isinf(read.views.range_r).all()


def test_every_view_is_where_the_table_says(table):
    _, stored = table.monostatic()
    near = Views.of(table.views.bisector_tilt_rad[-1:], range_r=table.views.range_r[-1])
    assert len(stored) == 25
    assert near.amplitude(10.0) == pytest.approx(table.amplitude[-1:, table.ka == 10.0][0], 1e-5)
    assert np.rad2deg(table.views.apart_rad[30:35]) == pytest.approx(np.full(5, 2.0))
    assert np.rad2deg(table.views.bisector_tilt_rad[30:35]) == pytest.approx([0, 10, 20, 30, 45])


def test_vertex_and_rings_arrive_when_rays_do(table):
    """(2 sqrt 2 - 2) R and R behind the vertex."""
    _, echoes = table.monostatic()
    found = {arrival.name: arrival.path for arrival in arrivals(table.ka, echoes[0])}
    resolution = 2 * np.pi / np.ptp(table.ka)
    late = found["two bounces"] - found["vertex"]
    assert late == pytest.approx((2 * np.sqrt(2) - 2) * SPHERE_RADIUS, abs=resolution / 4)
    later = found["three bounces"] - found["vertex"]
    assert later == pytest.approx(SPHERE_RADIUS, abs=resolution / 2)


def test_the_two_bounce_ring_towers_over_the_vertex(table):
    _, echoes = table.monostatic()
    peaks = {arrival.name: arrival.peak for arrival in arrivals(table.ka, echoes[0])}
    assert 15 < 20 * np.log10(peaks["two bounces"] / peaks["vertex"]) < 25


def test_the_fit_finds_the_constants_it_is_given():
    ka = np.arange(20.0, 120.0, 0.25)
    strengths = {2: 0.9 * np.exp(0.2j), 3: 0.7 * np.exp(-0.4j)}
    echo = sum(
        strengths[n] * ring_strength(ka, n) * np.exp(1j * ka * ring_path(n)) for n in BOUNCES
    )
    fitted = fit_glints(ka, echo)
    assert fitted["c_2"] == pytest.approx(strengths[2])
    assert fitted["c_3"] == pytest.approx(strengths[3])
    assert abs(fitted["vertex"]) < 1e-9


def test_a_comparison_finds_the_delay_and_the_level_it_is_given(table):
    late_s, radius_m = 3e-6, 0.035

    def method(ka, views):
        return 1.1 * exact(table)(ka, views) * np.exp(1j * ka * late_s * SPEED_M_S / radius_m)

    agreement = compare(method, radius_m, table=table)
    assert agreement.delay_s == pytest.approx(np.full(len(agreement.delay_s), late_s), abs=3e-7)
    assert agreement.level_db == pytest.approx(20 * np.log10(1.1))
    assert agreement.spectrum_db == pytest.approx(20 * np.log10(1.1))
    assert agreement.correlation.min() > 0.99


def test_a_comparison_tells_one_tilt_from_another(table):
    def upside_down(ka, views):
        return exact(table)(ka, views)[::-1]

    agreement = compare(upside_down, 0.07, table=table)
    assert agreement.correlation[0] < 0.95
    assert "tilt deg" in agreement.rows()[0]


def test_a_method_that_hears_nothing_has_no_delay(table):
    agreement = compare(lambda ka, views: 0 * exact(table)(ka, views), 0.035, table=table)
    assert np.isnan(agreement.delay_s).all()
    assert (agreement.correlation == 0).all()


def test_the_two_bounce_ring_turns_by_45_degrees_at_its_focal_line(table):
    """Stationary phase around the ring gives exp(i pi / 4), which c_2 = 1 leaves out."""
    _, echoes = table.monostatic()
    band = (table.ka > 25) & (table.ka < 100)
    fitted = fit_glints(table.ka[band], echoes[0, band])
    assert abs(fitted["c_2"]) == pytest.approx(1.0, abs=0.15)
    assert np.rad2deg(np.angle(fitted["c_2"])) == pytest.approx(45.0, abs=5.0)
    assert abs(fitted["c_3"]) < 0.5  # the rim, 2 degrees further out, cuts that ring


def test_a_band_beyond_the_table_is_refused(table):
    with pytest.raises(ValueError, match="choose another band"):
        compare(exact(table), 0.07, table=table, band_hz=(20e3, 120e3))


def test_a_method_of_the_wrong_shape_is_refused(table):
    with pytest.raises(ValueError, match="one row per view"):
        compare(lambda ka, views: np.ones(len(ka)), 0.07, table=table)
