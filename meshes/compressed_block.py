"""Write the mesh of the compressed block (supplement E.1) as a gmsh file.

    python meshes/compressed_block.py [--elements 16 8] [--cell quadrilateral|triangle] [--out FILE.msh]

The package makes the same mesh by itself (`shape = "compressed_block"` in a case file); this script is the
example of a mesh made by hand with gmsh: named physical groups are all that valvefsi asks for.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gmsh

LOWER, SIZE, LOAD_WIDTH = (10.0, 15.0), (20.0, 10.0), 10.0  # cm


def build(elements, cell):
    """Draw and mesh the block: elements (along, across), which must put nodes on the load's ends."""
    (x, y), (width, height) = LOWER, SIZE
    along, across = elements
    share = (width - LOAD_WIDTH) / 2 / width
    outer = round(share * along)
    if abs(outer - share * along) > 1e-9:
        raise SystemExit(f"{along} elements along {width:g} cm do not put nodes on the ends of the load")
    geo = gmsh.model.geo
    top_x = (x, x + share * width, x + (1 - share) * width, x + width)
    corners = [geo.addPoint(x, y, 0), geo.addPoint(x + width, y, 0)]
    tops = [geo.addPoint(px, y + height, 0) for px in top_x]
    bottom, right = geo.addLine(*corners), geo.addLine(corners[1], tops[3])
    top = [geo.addLine(tops[k + 1], tops[k]) for k in (2, 1, 0)]
    left = geo.addLine(tops[0], corners[0])
    surface = geo.addPlaneSurface([geo.addCurveLoop([bottom, right, *top, left])])
    counts = {bottom: along, right: across, left: across}
    counts |= dict(zip(top, (outer, along - 2 * outer, outer), strict=True))
    for curve, count in counts.items():
        geo.mesh.setTransfiniteCurve(curve, count + 1)
    geo.mesh.setTransfiniteSurface(surface, "AlternateRight", [*corners, tops[3], tops[0]])
    if cell == "quadrilateral":
        geo.mesh.setRecombine(2, surface)
    geo.synchronize()
    groups = {
        "bottom": [bottom],
        "sides": [left, right],
        "top_loaded": [top[1]],
        "top_outer": [top[0], top[2]],
    }
    for number, (name, curves) in enumerate(groups.items(), start=1):
        gmsh.model.addPhysicalGroup(1, curves, tag=number, name=name)
    gmsh.model.addPhysicalGroup(2, [surface], tag=1, name="block")
    gmsh.model.mesh.generate(2)


def main():
    """Read the command line and write the file."""
    parser = argparse.ArgumentParser(description="Write the mesh of the compressed block.")
    parser.add_argument("--elements", type=int, nargs=2, default=(16, 8))
    parser.add_argument("--cell", choices=("quadrilateral", "triangle"), default="quadrilateral")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("compressed_block.msh"))
    options = parser.parse_args()
    gmsh.initialize([], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    build(options.elements, options.cell)
    gmsh.write(str(options.out))
    gmsh.finalize()
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
