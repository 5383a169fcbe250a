"""Landmarks for the printer: closed, the right way out, and as exact as the docs say."""

import io
import json
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
import trimesh

from ertis_daemon.cli import main
from ertis_simulator.errors import SceneError
from ertis_simulator.landmark import RADII_MM, Dish
from ertis_simulator.mesh import lathe, stl_bytes
from ertis_simulator.printing import RIM_MM, Mount, landmark_mesh, plate_mesh


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices_mm, mesh.triangles, process=False)


def assert_solid(mesh, euler):
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0  # inside out, it would be negative
    assert mesh.euler_number == euler
    assert mesh.area_faces.min() > 0


def points_on(mesh, which):
    """Corners, middles of edges and middles of some triangles."""
    corners = mesh.vertices_mm[mesh.triangles[which]]
    edges = (corners + np.roll(corners, 1, axis=1)) / 2
    return np.concatenate([corners.reshape(-1, 3), edges.reshape(-1, 3), corners.mean(axis=1)])


@pytest.mark.parametrize("radius_mm", RADII_MM)
def test_a_dish_is_solid_and_its_concave_face_true_to_10_um(radius_mm):
    mesh = landmark_mesh(radius_mm)
    assert_solid(as_trimesh(mesh), euler=2)
    dish = Dish.landmark(radius_mm)
    sphere_mm, depth_mm = 1000 * dish.sphere_radius_m, 1000 * dish.depth_m
    centre = np.array([0, 0, sphere_mm])
    off = np.abs(np.linalg.norm(mesh.vertices_mm - centre, axis=1) - sphere_mm)
    face = (off[mesh.triangles] < 1e-9).all(axis=1)
    points = points_on(mesh, face)
    error = np.linalg.norm(points - centre, axis=1) - sphere_mm
    assert np.abs(error).max() < 0.010
    across = np.hypot(*points[:, :2].T)
    assert across.max() == pytest.approx(radius_mm)
    assert points[:, 2].max() == pytest.approx(depth_mm)
    assert depth_mm == pytest.approx(0.6 * radius_mm)
    facing = np.cross(*(np.diff(mesh.vertices_mm[mesh.triangles[face]], axis=1).swapaxes(0, 1)))
    assert facing[:, 2].min() > 0  # out of the solid is toward the sonar


def test_a_dish_has_a_thin_rim_a_boss_and_a_blind_hole():
    mesh = landmark_mesh(48)
    solid = as_trimesh(mesh)
    assert mesh.size_mm[2] == pytest.approx(0.6 * 48 + 3 + 12)
    assert mesh.size_mm[0] == pytest.approx(2 * (48 + RIM_MM), abs=0.01)
    at_rim = mesh.vertices_mm[np.isclose(mesh.vertices_mm[:, 2], 0.6 * 48)]
    assert sorted(set(np.hypot(*at_rim[:, :2].T).round(6))) == [48, 48 + RIM_MM]
    # Outside: in the opening, in the hole. Inside: between hole and face, in the boss.
    where = [(0, 0, 5), (0, 0, -10), (0, 0, -3), (6, 0, -14)]
    expected = [False, False, True, True]
    inside = [point_is_inside(solid, point) for point in where]
    assert inside == expected
    thickness = [wall_at(mesh, radius) for radius in (10, 30, 40, 47)]
    assert thickness == sorted(thickness, reverse=True)
    assert thickness[-1] < 2.0  # along the axis; the wall is 60 degrees steep there


def point_is_inside(mesh, point):
    """Solid angle of all triangles, by Van Oosterom and Strackee: 4 pi inside, 0 outside."""
    a, b, c = (mesh.triangles - np.array(point)).swapaxes(0, 1)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = np.einsum
    denominator = (
        la * lb * lc
        + dot("ij,ij->i", a, b) * lc
        + dot("ij,ij->i", b, c) * la
        + dot("ij,ij->i", c, a) * lb
    )
    return bool(abs(np.sum(2 * np.arctan2(numerator, denominator))) > 2 * np.pi)


def wall_at(mesh, radius):
    """Height of the solid at a distance from the axis."""
    across = np.hypot(*mesh.vertices_mm[:, :2].T)
    near = mesh.vertices_mm[np.abs(across - radius) < 1.0]
    middle = near[:, 2].mean()
    return near[near[:, 2] > middle, 2].mean() - near[near[:, 2] < middle, 2].mean()


def test_a_plate_has_one_hole_a_dish_under_its_axis():
    mesh, axes = plate_mesh([35, 58, 48], gap_mm=10)
    solid = as_trimesh(mesh)
    assert_solid(solid, euler=2 - 2 * 3)
    assert axes == pytest.approx([40.4, 80.8 + 63.4, 80.8 + 126.8 + 53.4])
    assert [point_is_inside(solid, (at, 16, 2.5)) for at in axes] == [False] * 3
    assert [point_is_inside(solid, (at + 4, 16, 2.5)) for at in axes] == [True] * 3
    assert mesh.size_mm == pytest.approx((80.8 + 126.8 + 106.8, 32, 5))
    for first, second, radii in ((0, 1, 35 + 58), (1, 2, 58 + 48)):
        assert axes[second] - axes[first] == pytest.approx(radii + 2 * RIM_MM + 10)


@pytest.mark.parametrize(
    ("radius", "mount", "said"),
    [
        (5, Mount(), "radius 5 mm, expected 10 to 150"),
        (48, Mount(hole_depth_mm=14), "leaves 1 mm before the concave face"),
        (48, Mount(hole_radius_mm=7.5), "expected a wall of 1 mm around it"),
        (48, Mount(wall_mm=0.5), "wall 0.5 mm"),
        (10, Mount(boss_radius_mm=9), "expected at most 0.8"),
        (float("nan"), Mount(), "radius nan mm"),
    ],
)
def test_a_dish_that_cannot_be_printed_is_refused(radius, mount, said):
    with pytest.raises(SceneError, match=said):
        landmark_mesh(radius, mount)


def test_a_lathe_refuses_a_profile_off_the_axis():
    with pytest.raises(ValueError, match="on the axis"):
        lathe(np.array([[1.0, 0.0], [2.0, 1.0], [0.0, 2.0]]), 8)


def test_stl_and_3mf_hold_the_same_dish(tmp_path, capsys):
    stl, threemf = tmp_path / "dish.stl", tmp_path / "dish.3mf"
    assert main(["export", "landmark", "--radius", "48", "-o", str(stl)]) == 0
    assert "concave side to the sonar" in capsys.readouterr().err
    assert main(["export", "landmark", "--radius", "48", "-o", str(threemf), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["size_mm"] == [96.8, 96.8, 43.8]
    read = trimesh.load_mesh(io.BytesIO(stl.read_bytes()), file_type="stl")
    assert_solid(read, euler=2)
    assert len(read.faces) == told["triangles"]
    assert not stl.read_bytes().startswith(b"solid")  # that would be a text STL
    with zipfile.ZipFile(threemf) as archive:
        assert archive.testzip() is None
        model = ET.fromstring(archive.read("3D/3dmodel.model"))
    space = {"m": "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"}
    assert model.get("unit") == "millimeter"
    vertices = [[float(v.get(k)) for k in "xyz"] for v in model.iterfind(".//m:vertex", space)]
    faces = [[int(t.get(f"v{k}")) for k in "123"] for t in model.iterfind(".//m:triangle", space)]
    again = trimesh.Trimesh(vertices, faces, process=False)
    assert_solid(again, euler=2)
    assert again.volume == pytest.approx(read.volume, rel=1e-5)


def test_the_same_command_makes_the_same_bytes_and_replaces_nothing_unasked(tmp_path, capsys):
    path = tmp_path / "plate.3mf"
    command = ["export", "landmark", "--plate", "35,48", "-o", str(path)]
    assert main(command) == 0
    first = path.read_bytes()
    assert main(command) == 1
    assert "exists: name another file, or give --force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0
    assert path.read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--radius", "48", "-o", "dish.obj"], "ends in .stl or .3mf"),
        (["--radius", "500", "-o", "dish.stl"], "radius 500 mm, expected 10 to 150"),
        (["--radius", "48", "-o", "/nowhere/dish.stl"], "cannot write /nowhere/dish.stl"),
        (["--radius", "48", "--hole", "20", "-o", "dish.stl"], "hole of radius 10 mm"),
        (["--plate", "35", "--gap", "-1", "-o", "p.stl"], "gap -1 mm"),
    ],
)
def test_what_cannot_be_exported_gets_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "landmark", *arguments]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert list(tmp_path.iterdir()) == []


def test_a_flat_sliver_in_an_stl_has_no_nan_in_its_normal():
    mesh = landmark_mesh(70)
    data = np.frombuffer(stl_bytes(mesh, "x")[84:], np.uint8).reshape(-1, 50)
    normals = data[:, :12].copy().view("<f4")
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
