"""Files with random damage, each read as a command would read it; every item follows from its seed alone."""

from __future__ import annotations

import random
import shutil
import signal
import tomllib
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
from mpi4py import MPI

from tests.campaign.outcomes import ACCEPTED, FAILED, REFUSED, RESUMED, ROWS_LOST
from tests.campaign.processes import BIAXIAL, difference
from valvefsi import fsi
from valvefsi.case import case_defaults, load_case, parse_case
from valvefsi.case.build import build, run_case
from valvefsi.case.expressions import read_table
from valvefsi.case.writing import to_toml
from valvefsi.errors import Stopped, ValvefsiError
from valvefsi.fitting.biaxial_records import read_biaxial
from valvefsi.fitting.waveforms import read_waveforms
from valvefsi.geometry.importing import import_mesh
from valvefsi.geometry.mesh import read_mesh

PATIENCE = 20
TIMERS = ((signal.SIGPROF, signal.ITIMER_PROF, 1), (signal.SIGALRM, signal.ITIMER_REAL, 6))
"""A hang is 20 s of computing, or 120 s by the clock where the machine is busy."""
SMALL = """
title = "stirred block"
[grid]
lower = ["0 cm", "0 cm"]
upper = ["1 cm", "1 cm"]
cells = [16, 16]
[fluid]
viscosity = "10 cP"
[fluid.sides]
y_upper = { velocity_expression = ["sin(pi*x)*min(t/0.01, 1)", "0"] }
x_upper = { type = "open", circuit = "outlet" }
[time]
dt = "2 ms"
t_end = "80 ms"
[output]
frames = 4
history_every = 4
checkpoint_every = 8
[[circuit]]
name = "outlet"
model = "downstream"
R_c = "0.05 mmHg*s/ml"
R_p = "0.8 mmHg*s/ml"
C = "2.4 ml/mmHg"
[[solid]]
name = "block"
mesh = { shape = "rectangle", lower = [0.375, 0.375], size = [0.25, 0.25], elements = [4, 4] }
material = { model = "neo_hookean", c1 = "10 dyn/cm^2" }
"""
NASTY = (
    *(
        "nan",
        "inf",
        "-1",
        "0",
        "1e400",
        "1e-400",
        "9" * 400,
        "true",
        '""',
        "[]",
        "{}",
        '"1 s**9**9**9"',
        '"1/0"',
    ),
    *(
        '"9**9**9"',
        "[1, 2]",
        '"../../etc/passwd"',
        '"\\u0000"',
        "-0.0",
        "1e12",
        "1e-12",
        '"1 furlong"',
        "0x" + "f" * 99,
    ),
    *(
        '"(-8)**0.5"',
        "[[1, 1], [2, 2]]",
        "1979-05-27",
        '"off"',
        "2.5",
        '"wall"',
        "[" * 200 + "]" * 200,
        '"x" * 3',
    ),
)
LINE = {"cases": "\n", "csv": ","}


def mutated(text: str, rng: random.Random, mark: str) -> str:
    """Return a text with one to four things wrong."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        match rng.randrange(8):
            case 0:
                del lines[at]
            case 1:
                lines.insert(at, rng.choice(lines))
            case 2 if "=" in lines[at]:
                lines[at] = f"{lines[at].partition('=')[0]}= {rng.choice(NASTY)}"
            case 3 if lines[at]:
                k = rng.randrange(len(lines[at]))
                lines[at] = (
                    lines[at][:k]
                    + rng.choice('0123456789.,-eE"[]{}=#;\t\0\u00e9\u2028 xyz')
                    + lines[at][k + 1 :]
                )
            case 4 if mark in lines[at]:
                cells = lines[at].split(mark)
                cells[rng.randrange(len(cells))] = rng.choice(NASTY).strip('"')
                lines[at] = mark.join(cells)
            case 5:
                lines[at] = lines[at][: rng.randrange(len(lines[at]) + 1)]
            case 6:
                lines = lines[: at + 1]
            case _:
                lines[at] += rng.choice((" ", ",", "1e9", "#", "s**9**9", "\ufeff"))
        text = "\n".join(lines)
    return text


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with flips, cuts, numbers or noise in them."""
    spoilt = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        at = rng.randrange(max(len(spoilt), 1))
        match rng.randrange(6):
            case 0 if spoilt:
                spoilt[at] ^= 1 << rng.randrange(8)
            case 1:
                del spoilt[at:]
            case 2 if spoilt:
                spoilt[at] = rng.choice(b"0123456789-.e")
            case 3:
                spoilt[at:at] = rng.choice((b"99999999", b"-1", b"nan", b"1e300", b"\xff" * 8, b"\n", b"\0"))
            case 4:
                del spoilt[at : at + rng.randrange(1, 200)]
            case _:
                spoilt[at : at + 8] = rng.randbytes(8)
    return bytes(spoilt)


def attack_case(rng: random.Random, folder: Path) -> str:
    """Read a case; where it is accepted, build it and take two steps."""
    path = folder / "case.toml"
    path.write_text(mutated(rng.choice((SMALL, SMALL, case_defaults())), rng, ","), encoding="utf-8")
    case = load_case(path)
    again = parse_case(tomllib.loads(to_toml(case)), file=path)
    if again.model_dump_json() != case.model_dump_json():
        return "WRONG: written and read it is another case"
    if np.prod([len(edges) - 1 for edges in case.grid.edges]) > 20_000:
        return ACCEPTED
    simulation = build(case, folder / "out", MPI.COMM_SELF)
    state = fsi.initial_state(simulation.model, simulation.schedule.dt)
    for _ in range(2):
        state = fsi.step(simulation.model, state, simulation.schedule.dt)
    rate = max(float(np.abs(u).max()) for u in state.u)
    return ACCEPTED if np.isfinite(rate) or rate * case.dt > case.time.cfl_max else FAILED


WAVES = "t_s,p_ao_mmHg,q_ao_ml_s,p_sd\n" + "\n".join(f"{0.01 * k},{80 + k},{3 * k},1" for k in range(40))
TABLE = "t_s,u\n" + "\n".join(f"{0.1 * k},{k % 3}" for k in range(20))


def attack_csv(rng: random.Random, folder: Path) -> str:
    """Read a record; where it is accepted, its numbers are finite and as many as its rows."""
    path, kind = folder / "record.csv", rng.randrange(3)
    text = mutated((BIAXIAL, WAVES, TABLE)[kind], rng, ",")
    if rng.random() < 0.2:
        path.write_bytes(damaged(text.encode(), rng))
    else:
        path.write_text(text, encoding="utf-8")
    if kind == 0:
        data = read_biaxial(path)
        numbers, count = np.concatenate([data.F.ravel(), data.stress.ravel()]), len(data.F)
    elif kind == 1:
        waves = read_waveforms(path)
        numbers, count = np.concatenate([waves.t, *waves.values.values()]), len(waves.t)
    else:
        table = read_table(path)
        numbers, count = np.concatenate([table.t, *table.columns.values()]), len(table.t)
    lines = path.read_bytes().decode("utf-8-sig").splitlines()
    rows = sum(1 for line in lines if line.strip() and not line.lstrip().startswith("#")) - 1
    return ACCEPTED if np.isfinite(numbers).all() and count == rows else f"WRONG: {count} of {rows} rows"


@cache
def meshes() -> dict[str, bytes]:
    """Return whole meshes of every format: a square and a box, text and binary, and a surface."""
    import tempfile

    import gmsh

    found = {}
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    for dim in (2, 3):
        gmsh.model.add(str(dim))
        occ = gmsh.model.occ
        body = occ.addRectangle(0, 0, 0, 1, 1) if dim == 2 else occ.addBox(0, 0, 0, 1, 1, 1)
        occ.synchronize()
        gmsh.model.addPhysicalGroup(dim, [body], name="body")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(dim)
        with tempfile.TemporaryDirectory() as folder:
            for version, binary in ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)):
                gmsh.option.setNumber("Mesh.MshFileVersion", version)
                gmsh.option.setNumber("Mesh.Binary", binary)
                path = Path(folder) / "a.msh"
                gmsh.write(str(path))
                found[f"{dim} {version} {binary}.msh"] = path.read_bytes()
            if dim == 3:
                for binary in (0, 1):
                    gmsh.option.setNumber("Mesh.Binary", binary)
                    path = Path(folder) / "a.stl"
                    gmsh.write(str(path))
                    found[f"{binary}.stl"] = path.read_bytes()
    gmsh.finalize()
    return found


def attack_mesh(rng: random.Random, folder: Path) -> str:
    """Read a mesh as a case does, or import it."""
    name = rng.choice(sorted(meshes()))
    path = folder / f"mesh{Path(name).suffix}"
    path.write_bytes(damaged(meshes()[name], rng))
    if path.suffix == ".stl" or rng.random() < 0.3:
        numbers = import_mesh(path, folder / "out.msh")
        volume = numbers["volume_cm3"]
        return ACCEPTED if np.isfinite(volume) and volume > 0 else f"WRONG: volume {volume}"
    mesh = read_mesh(path, MPI.COMM_SELF)
    return ACCEPTED if np.isfinite(mesh.mesh.geometry.x).all() else "WRONG: a point is not finite"


@cache
def whole(folder: Path) -> tuple[Path, Path]:
    """Return the folder of a whole run and that of one that was broken off, made once."""
    case = parse_case(tomllib.loads(SMALL))
    run_case(case, out=folder / "whole", comm=MPI.COMM_SELF, overwrite=True)

    def stop(step: int, *_: object) -> None:
        if step == 30:
            raise Stopped("enough", 15)

    with suppress(Stopped):
        run_case(case, out=folder / "broken", comm=MPI.COMM_SELF, overwrite=True, progress=stop)
    return folder / "whole", folder / "broken"


def attack_folder(rng: random.Random, folder: Path) -> str:
    """Damage a folder of a run that was broken off, resume it, and compare with the whole run."""
    end, broken = whole(folder.parent)
    out = folder / "run"
    shutil.copytree(broken, out)
    for _ in range(rng.choice((1, 1, 2, 3))):
        files = sorted(path for path in out.rglob("*") if path.is_file())
        first = sorted((out / "checkpoints").iterdir()) + [out / "history.csv", out / "case.toml"]
        path = rng.choice(
            files if rng.random() < 0.5 else [path for path in first if path.is_file()] or files
        )
        match rng.randrange(6):
            case 0:
                path.unlink()
            case 1:
                shutil.copy(
                    path, path.with_name(rng.choice(("step_00000099.vfc", "step_abc.vfc", "notes.txt", "b")))
                )
            case 2:
                other = rng.choice(files)
                if other.is_file() and other != path:
                    shutil.copy(other, path)
            case 3:
                (path.parent / rng.choice(("step_00000050.vfc", "x", ".lock"))).mkdir(exist_ok=True)
            case _:
                path.write_bytes(damaged(path.read_bytes(), rng))
    run_case(parse_case(tomllib.loads(SMALL)), out=out, resume=True, comm=MPI.COMM_SELF)
    gap = difference(out, end)
    if gap <= 1e-12:
        return RESUMED
    return ROWS_LOST if last_gap(out, end) <= 1e-12 else f"WRONG: {gap:.1e} off"


def last_gap(out: Path, end: Path) -> float:
    """Return the difference of the last rows alone."""
    a, b = (
        np.array([float(v) for v in (f / "history.csv").read_text().split("\n")[-2].split(",")])
        for f in (out, end)
    )
    return float(np.abs((a - b) / np.maximum(np.abs(b), 1e-12)).max())


ATTACKS: dict[str, Callable[[random.Random, Path], str]] = {
    "cases": attack_case,
    "csv": attack_csv,
    "meshes": attack_mesh,
    "folders": attack_folder,
}


class Hang(BaseException):
    """An item took longer than `PATIENCE`."""


def _late(*_: object) -> None:
    raise Hang


def one(kind: str, seed: int, number: int, folder: Path) -> str:
    """Return what comes of one item."""
    rng = random.Random(f"{kind} {seed} {number}")
    place = folder / f"{kind}_{number}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    if kind == "folders":
        whole(folder)
    for number, timer, patience in TIMERS:
        signal.signal(number, _late)
        signal.setitimer(timer, patience * PATIENCE)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcome = ATTACKS[kind](rng, place)
    except (ValvefsiError, OSError) as error:
        lines = str(error).splitlines()
        outcome = (
            REFUSED if len(lines) == 1 and len(lines[0]) < 2100 else f"NOT ONE LINE: {str(error)[:200]!r}"
        )
    except Hang:
        outcome = "HANG"
    except Exception as error:
        outcome = f"TRACEBACK: {type(error).__name__}: {str(error)[:150]!r}"
    finally:
        for _, timer, _ in TIMERS:
            signal.setitimer(timer, 0)
    if outcome in (REFUSED, ACCEPTED) or outcome.startswith("resumed"):
        shutil.rmtree(place, ignore_errors=True)
    return outcome
