"""``ertis export landmark``: dishes and plates for a 3D printer."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ertis_simulator.mesh import Mesh

EPILOG = """\
A dish is a spherical cap, 0.6 of its radius deep, with a rim of 0.4 mm and a boss with a blind hole
on its back. THE CONCAVE SIDE FACES THE SONAR; the boss is for the mount. Facets are within 10 um of
the true surface. A plate holds dishes side by side, screwed on from behind.

Examples:
  ertis export landmark --radius 48 -o r48.stl
  ertis export landmark --plate 35,58,48 -o plate.3mf
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--radius", type=float, metavar="MM", help="dish of this radius: 35, 48, 58, 70 or another"
    )
    what.add_argument(
        "--plate", type=_radii, metavar="MM,MM,...", help="plate for dishes of these radii in a row"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help=".stl or .3mf to make"
    )
    parser.add_argument("--hole", type=float, metavar="MM", help="diameter of the hole, default 5")
    parser.add_argument(
        "--gap", type=float, default=10.0, metavar="MM", help="between a plate's rims, default 10"
    )
    parser.add_argument("--force", action="store_true", help="replace FILE if it is there")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Write the file."""
    from ertis_driver.errors import SettingsError
    from ertis_simulator.mesh import stl_bytes, threemf_bytes

    writers = {".stl": stl_bytes, ".3mf": threemf_bytes}
    writer = writers.get(args.output.suffix.lower())
    if writer is None:
        raise SettingsError(f"{args.output}, expected a name that ends in .stl or .3mf")
    mesh, title, told = _mesh(args)
    try:
        with args.output.open("wb" if args.force else "xb") as file:
            file.write(writer(mesh, title))
    except FileExistsError as error:
        raise SettingsError(f"{args.output} exists: name another file, or give --force") from error
    except OSError as error:
        raise SettingsError(f"cannot write {args.output}: {error.strerror}") from error
    size = [round(value, 2) for value in mesh.size_mm]
    told = {"file": str(args.output), "title": title, "size_mm": size, **told}
    told["triangles"] = len(mesh.triangles)
    if args.json:
        print(json.dumps(told))
    else:
        print(
            f"{args.output}: {title}, {size[0]:g} x {size[1]:g} x {size[2]:g} mm, "
            f"{len(mesh.triangles)} triangles",
            file=sys.stderr,
        )
    return 0


def _mesh(args: argparse.Namespace) -> tuple[Mesh, str, dict[str, Any]]:
    from ertis_simulator.printing import Mount, landmark_mesh, plate_mesh

    mount = Mount() if args.hole is None else Mount(hole_radius_mm=args.hole / 2)
    if args.radius is not None:
        mesh = landmark_mesh(args.radius, mount)
        return mesh, f"ertis landmark r{args.radius:g}, concave side to the sonar", {}
    mesh, axes = plate_mesh(args.plate, args.gap, mount=mount)
    names = " ".join(f"r{radius:g}" for radius in args.plate)
    return mesh, f"ertis plate for {names}", {"axes_mm": [round(at, 3) for at in axes]}


def _radii(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}, expected radii such as 35,58,48") from None
