"""ParaView series: the bytes decode to the fields, pieces tile the grid, restarts leave no gap or double."""

import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.io.paraview import FluidSeries, SolidSeries
from valvefsi.io.series import frames_on_disk, read_times

CELLS = (8, 5, 3)
LOWER, SPACING = (-1.0, 0.5, 0.0), (0.25, 0.25, 0.25)


def fields(t, cells=CELLS):
    centre = [lo + h * (np.arange(n) + 0.5) for lo, h, n in zip(LOWER, SPACING, cells, strict=True)]
    x, y, z = np.meshgrid(*centre, indexing="ij")
    return np.stack([x + t, 10 * y, x * z], axis=-1), x + 100 * y + 10000 * z


def series(comm, directory, cells=CELLS, **options):
    first, last = (cells[0] * (comm.rank + k) // comm.size for k in (0, 1))
    start, size = (first, 0, 0), (last - first, *cells[1:])
    return FluidSeries(directory, "fluid", comm, cells, start, size, (LOWER, SPACING), **options)


def write(writer, t, cells=CELLS):
    first = writer.extents[writer.comm.rank][0]
    velocity, pressure = fields(t, cells)
    part = slice(first, first + writer.shape[0])
    writer.write(t, velocity[part], pressure[part])
    writer.comm.barrier()


def read_piece(path):
    """Decode a piece by hand: (extent, {name: array[x, y, z(, c)]}, attributes of the image)."""
    content = path.read_bytes()
    head, data = content.split(b'<AppendedData encoding="raw">_', 1)
    root = ET.fromstring(head + b"</VTKFile>")
    assert data.rstrip().endswith(b"</AppendedData></VTKFile>")
    assert root.get("header_type") == "UInt64"
    image = root.find("ImageData")
    extent = [int(v) for v in image.find("Piece").get("Extent").split()]
    size = [extent[2 * a + 1] - extent[2 * a] for a in range(3)]
    arrays = {}
    for item in image.iter("DataArray"):
        offset, components = int(item.get("offset")), int(item.get("NumberOfComponents"))
        blocks, _, last = (int(v) for v in np.frombuffer(data, dtype=np.uint64, count=3, offset=offset))
        assert blocks == 1
        length = int(np.frombuffer(data, dtype=np.uint64, count=1, offset=offset + 24)[0])
        content = zlib.decompress(data[offset + 32 : offset + 32 + length])
        assert len(content) == last == 4 * components * np.prod(size)
        values = np.frombuffer(content, dtype=np.float32)
        arrays[item.get("Name")] = values.reshape(*size[::-1], components).transpose(2, 1, 0, 3)
    return extent, arrays, image.attrib


def entries(path):
    return [(float(e.get("timestep")), e.get("file")) for e in ET.parse(path).getroot().iter("DataSet")]


def test_the_pieces_tile_the_grid_and_decode_to_the_fields(comm, shared_tmp):
    write(series(comm, shared_tmp), 0.5)
    ((time, name),) = entries(shared_tmp / "fluid.pvd")
    assert time == 0.5
    whole = ET.parse(shared_tmp / name).getroot().find("PImageData")
    assert whole.get("WholeExtent") == "0 8 0 5 0 3"
    assert [float(v) for v in whole.get("Origin").split()] == list(LOWER)
    velocity, pressure = fields(0.5)
    covered = np.zeros(CELLS, dtype=int)
    for piece in whole.iter("Piece"):
        extent, arrays, attributes = read_piece(shared_tmp / Path(name).parent / piece.get("Source"))
        assert piece.get("Extent") == " ".join(map(str, extent))
        assert attributes["Origin"] == whole.get("Origin")
        assert attributes["Spacing"] == whole.get("Spacing")
        cells = tuple(slice(extent[2 * a], extent[2 * a + 1]) for a in range(3))
        covered[cells] += 1
        np.testing.assert_array_equal(arrays["velocity"], velocity[cells].astype(np.float32))
        np.testing.assert_array_equal(arrays["pressure"][..., 0], pressure[cells].astype(np.float32))
    assert (covered == 1).all()
    assert [e.get("Name") for e in whole.iter("PDataArray")] == ["velocity", "pressure"]


def test_vtk_reads_the_pieces_of_a_graded_grid_back(comm, shared_tmp):
    reading = pytest.importorskip("vtkmodules.vtkIOXML")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    cells = (70, 80, 60) if comm.size == 1 else CELLS  # more than one compressed block
    edges = [lo + np.cumsum(np.linspace(0.0, 1.0, n + 1)) for lo, n in zip(LOWER, cells, strict=True)]
    first, last = (cells[0] * (comm.rank + k) // comm.size for k in (0, 1))
    start, size = (first, 0, 0), (last - first, *cells[1:])
    writer = FluidSeries(shared_tmp, "fluid", comm, cells, start, size, edges)
    write(writer, 0.5, cells)
    velocity, pressure = fields(0.5, cells)
    ((_, name),) = entries(shared_tmp / "fluid.pvd")
    reader = reading.vtkXMLPRectilinearGridReader()
    reader.SetFileName(str(shared_tmp / name))
    reader.Update()
    grid = reader.GetOutput()
    for axis, wanted in zip("XYZ", edges, strict=True):
        np.testing.assert_array_equal(vtk_to_numpy(getattr(grid, f"Get{axis}Coordinates")()), wanted)
    values = vtk_to_numpy(grid.GetCellData().GetArray("pressure")).reshape(cells[::-1]).transpose(2, 1, 0)
    np.testing.assert_array_equal(values, pressure.astype(np.float32))
    values = (
        vtk_to_numpy(grid.GetCellData().GetArray("velocity")).reshape(*cells[::-1], 3).transpose(2, 1, 0, 3)
    )
    np.testing.assert_array_equal(values, velocity.astype(np.float32))
    comm.barrier()


def test_a_rank_without_cells_writes_no_piece(comm, shared_tmp):
    writer = FluidSeries(
        shared_tmp, "fluid", comm, (2, 2, 1), (0, 0, 0), (2 * (comm.rank == 0), 2, 1), (LOWER, SPACING)
    )
    nx = writer.shape[0]
    writer.write(0.0, np.zeros((nx, 2, 1, 3)), np.zeros((nx, 2, 1)))
    comm.barrier()
    assert sorted(p.name for p in (shared_tmp / "fluid").iterdir()) == [
        "fluid_000000.pvti",
        "fluid_000000_0000.vti",
    ]


def test_a_resumed_series_has_no_gap_and_no_double(comm, shared_tmp):
    writer = series(comm, shared_tmp)
    for t in (0.0, 0.1, 0.2, 0.30000000000000004):
        write(writer, t)
    if comm.rank == 0:  # a piece of a frame that was not finished, by a rank that no longer is
        (shared_tmp / "fluid" / "fluid_000004_0007.vti").write_text("torn")
    writer = series(comm, shared_tmp, frames=[0.0, 0.1, 0.2])
    assert [t for t, _ in entries(shared_tmp / "fluid.pvd")] == [0.0, 0.1, 0.2]
    comm.barrier()
    for t in (0.2, 0.3, 0.4):
        write(writer, t)
    found = entries(shared_tmp / "fluid.pvd")
    assert [t for t, _ in found] == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert [name for _, name in found] == [f"fluid/fluid_{k:06d}.pvti" for k in range(5)]
    files = {path.name for path in (shared_tmp / "fluid").iterdir()}
    assert files == {Path(n).name for _, n in found} | {
        f"fluid_{k:06d}_{rank:04d}.vti" for k in range(5) for rank in range(comm.size)
    }


def test_a_new_run_replaces_the_series_and_leaves_others_alone(comm, shared_tmp):
    write(series(comm, shared_tmp), 0.0)
    if comm.rank == 0:
        (shared_tmp / "fluid" / "notes.txt").write_text("mine")
    series(comm, shared_tmp)
    assert entries(shared_tmp / "fluid.pvd") == []
    assert [path.name for path in (shared_tmp / "fluid").iterdir()] == ["notes.txt"]


def test_arrays_of_another_shape_are_refused_on_all_ranks(comm, shared_tmp):
    writer = series(comm, shared_tmp)
    nx = writer.shape[0] - (comm.rank == 0)
    with pytest.raises(ValueError, match="expected arrays of"):
        writer.write(0.0, np.zeros((nx, 5, 3, 3)), np.zeros(writer.shape))
    with pytest.raises(ValueError, match="expected arrays of"):
        writer.write(0.0, np.zeros((*writer.shape, 3)), np.zeros((nx, 5, 3)))


def test_a_solid_is_read_back_with_displacement_and_J(comm, shared_tmp):
    points = np.array([[0, 0, 0.5], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0.5], [2, 0, 0.5]], dtype=float)
    cells = {9: np.array([[0, 1, 2, 3]]), 5: np.array([[1, 4, 2]])}
    data = (points, cells, np.array([0.9, 1.1]), 0.1 * points) if comm.rank == 0 else (None,) * 4
    writer = SolidSeries(shared_tmp, "block", comm)
    for t in (0.0, 0.5):
        writer.write(t, *data)
    writer = SolidSeries(shared_tmp, "block", comm, frames=[0.0])
    writer.write(0.25, *data)
    comm.barrier()
    found = entries(shared_tmp / "block.pvd")
    assert found == [(0.0, "block/block_000000.vtu"), (0.25, "block/block_000001.vtu")]
    mesh = meshio.read(shared_tmp / found[1][1])
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(mesh.point_data["displacement"], 0.1 * points)
    assert [(block.type, block.data.tolist()) for block in mesh.cells] == [
        ("quad", [[0, 1, 2, 3]]),
        ("triangle", [[1, 4, 2]]),
    ]
    assert [float(block[0]) for block in mesh.cell_data["J"]] == [0.9, 1.1]


def rewritten(path, damage):
    path.write_bytes(damage(path.read_bytes()))


def without_the_second_entry(text):
    lines = text.splitlines(keepends=True)
    return b"".join(line for line in lines if b'timestep="0.5"' not in line)


DAMAGE = {
    "an entry is lost": (without_the_second_entry, "1 of 3 entries are put in again from the checkpoint"),
    "cut short": (lambda text: text[: text.index(b'timestep="0.5"')], "2 of 3 entries are put in again"),
    "empty": (lambda text: b"", "3 of 3 entries"),
    "another time": (lambda text: text.replace(b'"0.5"', b'"0.6"'), "1 of 3 entries"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_list_of_times_costs_no_frame(kind, comm, shared_tmp):
    """Later frames have numbers of their own, earlier ones stay to the byte, the list has all of them."""
    writer = series(comm, shared_tmp)
    for t in (0.0, 0.5, 1.0, 1.5):  # the last is of a later time than the checkpoint
        write(writer, t)
    path, (damage, said) = shared_tmp / "fluid.pvd", DAMAGE[kind]
    earlier = [f for k in range(3) for f in sorted((shared_tmp / "fluid").glob(f"fluid_{k:06d}*"))]
    before = [f.read_bytes() for f in earlier]
    comm.barrier()
    if comm.rank == 0:
        rewritten(path, damage)
        with pytest.warns(UserWarning, match=rf"fluid\.pvd: {said}") as caught:
            again = series(comm, shared_tmp, frames=[0.0, 0.5, 1.0])
        assert [len(str(c.message).splitlines()) for c in caught] == [1]
    else:
        again = series(comm, shared_tmp, frames=[0.0, 0.5, 1.0])
    assert [t for t, _ in read_times(path)] == [0.0, 0.5, 1.0]
    comm.barrier()
    for t in (2.0, 3.0):
        write(again, t)
    assert read_times(path) == [
        (t, f"fluid/fluid_{k:06d}.pvti") for k, t in enumerate((0.0, 0.5, 1.0, 2.0, 3.0))
    ]
    assert [f.read_bytes() for f in earlier] == before


def test_a_frame_whose_file_is_gone_keeps_its_number(comm, shared_tmp):
    writer = series(comm, shared_tmp)
    for t in (0.0, 0.5, 1.0):
        write(writer, t)
    if comm.rank == 0:
        (shared_tmp / "fluid" / "fluid_000001.pvti").unlink()
        with pytest.warns(UserWarning, match=r"the files of 1 frame \(1\) are gone$"):
            again = series(comm, shared_tmp, frames=[0.0, 0.5, 1.0])
    else:
        again = series(comm, shared_tmp, frames=[0.0, 0.5, 1.0])
    write(again, 2.0)
    found = entries(shared_tmp / "fluid.pvd")
    assert found == [(t, f"fluid/fluid_{k:06d}.pvti") for k, t in ((0, 0.0), (2, 1.0), (3, 2.0))]


def test_a_checkpoint_without_frames_takes_their_times_from_all_lists(tmp_path):
    """What one list has lost another knows; what none knows keeps its number, and what is later goes."""
    for name in ("fluid", "block"):
        writer = SolidSeries(tmp_path, name, MPI.COMM_SELF)
        for t in (0.0, 0.5, 1.0, 1.5, 2.0):
            writer.index.add(
                t, writer.index.stem(t).with_suffix(".vtu"), lambda path: path.write_text("frame")
            )
    assert frames_on_disk(tmp_path, 1.5) == [0.0, 0.5, 1.0, 1.5]
    rewritten(tmp_path / "fluid.pvd", without_the_second_entry)
    assert frames_on_disk(tmp_path, 1.5) == [0.0, 0.5, 1.0, 1.5]
    rewritten(tmp_path / "block.pvd", lambda text: text[: text.index(b"<DataSet")])
    assert frames_on_disk(tmp_path, 1.5) == [0.0, None, 1.0, 1.5]
    with pytest.warns(UserWarning, match=r"the times of 1 frame \(1\) are not known, their files stay$"):
        writer = SolidSeries(tmp_path, "fluid", MPI.COMM_SELF, frames=[0.0, None, 1.0, 1.5])
    assert [path.name for path in sorted((tmp_path / "fluid").iterdir())] == [
        f"fluid_{k:06d}.vtu" for k in range(4)
    ]
    assert writer.index.stem(1.75).name == "fluid_000004"


def test_a_list_of_times_leads_to_no_file_outside_its_folder(tmp_path):
    items = ["../a.vtu", "/etc/passwd", "fluid/b.vtu"]
    lines = [f'<DataSet timestep="{t}" part="0" file="{item}"/>' for t, item in enumerate(items)]
    (tmp_path / "fluid.pvd").write_text(
        "\n".join([*lines, '<DataSet timestep="nan" file="c.vtu"/>', "<DataSet"])
    )
    assert read_times(tmp_path / "fluid.pvd") == [(2.0, "fluid/b.vtu")]
