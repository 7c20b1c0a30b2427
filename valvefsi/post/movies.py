"""Pictures of slices of a run's fluid series, one of them or all as a movie."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from valvefsi.errors import CaseError
from valvefsi.io.folder import replacing
from valvefsi.io.grid_files import GridFields, nearest_time, read_grid, times_of
from valvefsi.io.series import read_times
from valvefsi.io.solid_body import Body, read_body
from valvefsi.post.plots.slice import draw_slice, palette
from valvefsi.post.slices import Plane, cut, outline, scale_of
from valvefsi.runtime.installing import how_to_add
from valvefsi.types import Array

SERIES = {"mean": "averages", "turbulence": "averages"}
"""Series of the fields whose names begin so; the others are in that of the fluid."""


def series_of(folder: Path, name: str) -> Path:
    """Return the series of a run that holds a field."""
    return Path(folder) / "paraview" / f"{SERIES.get(name.split('_')[0], 'fluid')}.pvd"


def draw_plane(
    folder: Path,
    out: Path,
    *,
    plane: Plane | None,
    field: str,
    t: float | None = None,
    lines: Sequence[Array] = (),
) -> Path:
    """Draw one time of a field of a run in a plane, with its solids.

    Args:
        folder: Folder of the run.
        out: Folder of the picture.
        plane: The plane; None in two dimensions.
        field: What is shown.
        t: Time, the nearest there is; the last if None [s].
        lines: Dashed lines over it, both ends in the plane's coordinates, ``(2, 2)`` each [cm].

    Raises:
        CaseError: There is no series, no such field, or no such plane.
    """
    when, file = nearest_time(series_of(folder, field), t)
    grid = read_grid(file, when)
    plane = _plane(grid, plane)
    found = cut(grid, plane, field)
    solids = [outline(body, plane, grid.dim) for body in bodies_at(folder, when)]
    path = Path(out) / f"slice_{_place(grid, plane, '_')}{field}.png"
    return draw_slice(
        path, found, solids=solids, lines=lines, title=field.replace("_", " "), caption=_caption(grid, plane)
    )


def draw_movie(
    folder: Path,
    path: Path,
    *,
    plane: Plane | None,
    field: str,
    fps: int = 20,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Make a movie of all times of a field in a plane, with one scale.

    Args:
        folder: Folder of the run.
        path: The movie, .mp4 (see `find_ffmpeg`) or .gif.
        plane: The plane; None in two dimensions.
        field: What is shown.
        fps: Frames a second.
        progress: Called with the frames done and all of them.

    Raises:
        CaseError: There is no series, no such field or plane, or no ffmpeg for an .mp4.
    """
    path = Path(path)
    if path.suffix not in (".mp4", ".gif"):
        raise CaseError("expected a name that ends in .mp4 or .gif", key="--out", value=str(path))
    if path.suffix == ".mp4" and find_ffmpeg() is None:
        message = (
            f"an .mp4 needs ffmpeg, which is not here ({how_to_add('movies')} brings one); a .gif does not"
        )
        raise CaseError(message, key="--out", value=str(path))
    times = times_of(series_of(folder, field))
    limits = _limits(times, plane, field)
    path.parent.mkdir(parents=True, exist_ok=True)
    frames = _frames(folder, times, plane, field, limits, path, progress)
    with replacing(path) as temporary:
        if path.suffix == ".gif":
            _write_gif(temporary, frames, fps, palette(limits))
        else:
            _write_mp4(temporary, frames, fps)
    return path


def find_ffmpeg() -> str | None:
    """Return the ffmpeg on the path, else that of the package imageio-ffmpeg; None where neither is there."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        return None
    try:
        return str(get_ffmpeg_exe())
    except RuntimeError:  # the package came without its program
        return None


def _frames(
    folder: Path,
    times: list[tuple[float, Path]],
    plane: Plane | None,
    field: str,
    limits: tuple[float, float],
    path: Path,
    progress: Callable[[int, int], None] | None,
) -> Iterator[Path]:
    """Draw frame after frame; the file of each is removed when the next is asked for."""
    for number, (when, file) in enumerate(times):
        grid = read_grid(file, when)
        at = _plane(grid, plane)
        solids = [outline(body, at, grid.dim) for body in bodies_at(folder, when)]
        picture = path.with_name(f".{path.stem}_{number:05d}.png")
        title, caption = field.replace("_", " "), _caption(grid, at)
        yield draw_slice(
            picture, cut(grid, at, field), solids=solids, limits=limits, title=title, caption=caption
        )
        picture.unlink()
        if progress is not None:
            progress(number + 1, len(times))


def _limits(times: list[tuple[float, Path]], plane: Plane | None, field: str) -> tuple[float, float]:
    """One scale for all times, from ten of them."""
    chosen = times[:: max(1, len(times) // 10)]
    values = []
    for when, file in chosen:
        grid = read_grid(file, when)
        values.append(cut(grid, _plane(grid, plane), field).values.ravel())
    return scale_of(np.concatenate(values))


def _write_gif(path: Path, frames: Iterator[Path], fps: int, colours: Array) -> None:
    """Write frames with the nearest of ``colours``, ``(256, 3)``: the same in all, so that none changes by itself."""
    from PIL import Image

    images = []
    for frame in frames:
        with Image.open(frame) as image:
            pixels = np.asarray(image.convert("RGB"), dtype=np.uint32)
        indexed = Image.fromarray(_nearest(pixels, colours))
        indexed.putpalette(colours.astype(np.uint8).tobytes())
        images.append(indexed)
    images[0].save(path, save_all=True, append_images=images[1:], duration=round(1000 / fps), loop=0)


def _nearest(pixels: NDArray[np.uint32], colours: Array) -> NDArray[np.uint8]:
    """Return the number of the nearest colour for each pixel of ``(n, m, 3)``, ``(n, m)``."""
    packed = (pixels[..., 0] << 16) + (pixels[..., 1] << 8) + pixels[..., 2]
    found, place = np.unique(packed, return_inverse=True)
    there = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=1).astype(np.float64)
    nearest = cKDTree(colours).query(there)[1].astype(np.uint8)
    return nearest[place].reshape(packed.shape)


def _write_mp4(path: Path, frames: Iterator[Path], fps: int) -> None:
    import subprocess

    first, raw = _pixels(next(frames))
    command = [
        find_ffmpeg() or "ffmpeg",
        "-y",
        "-loglevel",
        "error",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        first,
    ]
    command += ["-r", str(fps), "-i", "-", "-pix_fmt", "yuv420p", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.write(raw)
        for frame in frames:
            process.stdin.write(_pixels(frame)[1])
    if process.returncode != 0:
        raise CaseError("ffmpeg could not make the movie", file=path)


def _pixels(frame: Path) -> tuple[str, bytes]:
    """Return size and pixels of a picture, without an odd row or column."""
    from PIL import Image

    with Image.open(frame) as image:
        width, height = (n - n % 2 for n in image.size)
        return f"{width}x{height}", image.convert("RGB").crop((0, 0, width, height)).tobytes()


def bodies_at(folder: Path, t: float) -> list[Body]:
    """Return the solids of a run at time t, without the series of stresses."""
    found = [read_body(file) for file in sorted((Path(folder) / "paraview").glob("*.vtu"))]  # what stays
    for series in sorted((Path(folder) / "paraview").glob("*.pvd")):
        if series.stem in ("fluid", "averages") or series.stem.endswith("_stress"):
            continue
        for when, name in read_times(series):
            file = series.parent / name
            if abs(when - t) > 1e-9 * max(1.0, abs(t)):
                continue
            if file.suffix == ".vtu" and file.is_file():
                found.append(read_body(file))
    return found


def _plane(grid: GridFields, plane: Plane | None) -> Plane:
    if plane is None and grid.dim == 3:
        raise CaseError("a run in space needs a plane, such as z=0", key="--slice")
    if plane is not None and grid.dim == 2:
        where = f"{'xyz'[plane.axis]}={plane.position:g} cm"
        message = "a run in two dimensions is drawn whole, leave this out"
        raise CaseError(message, key="--slice", value=where)
    return plane or Plane(axis=2, position=0.0)


def _place(grid: GridFields, plane: Plane, end: str) -> str:
    return "" if grid.dim == 2 else f"{'xyz'[plane.axis]}{plane.position:g}{end}"


def _caption(grid: GridFields, plane: Plane) -> str:
    where = "" if grid.dim == 2 else f"{'xyz'[plane.axis]} = {10.0 * plane.position:g} mm, "
    return f"{where}t = {grid.t:.4g} s"
