"""Mesh files from elsewhere: each must begin as its kind does, and is read by a reader that runs nothing.

The kind follows from the ending of the name and the first bytes together, so that no reader has to guess.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.errors import CaseError

XML = (b"<?xml", b"<VTKFile", b"<Xdmf")
BEGINNINGS: dict[str, tuple[bytes, ...]] = {
    "gmsh": (b"$MeshFormat",),
    "stl": (b"solid",),
    "vtu": XML,
    "xdmf": XML,
    "vtk": (b"# vtk DataFile",),
    "ply": (b"ply",),
    "off": (b"OFF",),
}
"""What a file of each kind begins with; meshio's module of that name reads it."""
ENDINGS = {".msh": "gmsh", **{f".{kind}": kind for kind in BEGINNINGS if kind != "gmsh"}}
FEW = 512
STL_HEAD, STL_TRIANGLE = 84, 50


def check_beginning(path: Path, kinds: Collection[str] = tuple(BEGINNINGS)) -> str:
    """Return the kind of a mesh file.

    Args:
        path: The file.
        kinds: Kinds that are expected, of `BEGINNINGS`.

    Raises:
        CaseError: There is no such file, it is empty, or it does not begin as its ending says.
    """
    kind = ENDINGS.get(path.suffix.lower())
    if kind is None or kind not in kinds:
        known = ", ".join(ending for ending, each in ENDINGS.items() if each in kinds)
        raise CaseError(f"expected a file that ends in one of {known}", file=path)
    if not path.is_file():
        raise CaseError("no such mesh file", file=path)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(FEW)
    except OSError as error:
        raise CaseError(f"cannot be read ({error.strerror})", file=path) from None
    if size == 0:
        raise CaseError("the file is empty", file=path)
    if kind == "stl" and size >= STL_HEAD:
        count = int.from_bytes(start[80:84], "little")
        if size == STL_HEAD + STL_TRIANGLE * count:
            if count == 0:
                raise CaseError("the file holds no triangles", file=path)
            return kind
    if not start.lstrip().startswith(BEGINNINGS[kind]) or (kind == "gmsh" and start[:1] != b"$"):
        expected = " or ".join(beginning.decode() for beginning in BEGINNINGS[kind])
        raise CaseError(f"cannot read this file: it does not begin with {expected}", file=path)
    return kind


def read_mesh_file(path: Path, kinds: Collection[str] = tuple(BEGINNINGS)) -> Any:
    """Read a mesh file as meshio's mesh: finite points, cells whose nodes exist.

    Args:
        path: The file.
        kinds: Kinds that are expected, of `BEGINNINGS`.

    Raises:
        CaseError: The file is not what it says, or cannot be read.
    """
    kind = check_beginning(path, kinds)
    try:
        with np.errstate(over="ignore"):  # the text of an STL file is taken for a number of triangles first
            mesh = importlib.import_module(f"meshio.{kind}").read(str(path))
        points = np.asarray(mesh.points, dtype=float)
        sound = bool(points.ndim == 2 and points.shape[1] in (2, 3) and np.isfinite(points).all())
        for block in mesh.cells:
            nodes = np.asarray(block.data)
            sound = sound and (nodes.size == 0 or bool(nodes.min() >= 0 and nodes.max() < len(points)))
    except (Exception, SystemExit) as error:  # readers of damaged files raise whatever they like
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CaseError(f"cannot read this file: {reason[:200]}", file=path) from None
    if not len(points):
        raise CaseError("the file holds no points", file=path)
    if not sound:
        raise CaseError("a point is not finite, or a cell has a point that is not there", file=path)
    return mesh
