"""Run the benchmarks that take about a minute or less, and keep their numbers in ``docs/results``.

    python docs/measure.py              all of them, one after another
    python docs/measure.py cavity fits  those named so

A file of results holds the quantities with their references, the commands, the parameters, version, commit, date,
ranks and cores. Files with ``"origin": "stored"`` are of runs that take longer; they name the commit that published
them and are not touched here. Afterwards ``make tables`` writes the numbers into the documents.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).resolve().parent / "results"

COMMANDS: dict[str, tuple[str, dict[str, str]]] = {
    "statics": (
        "Incompressible statics, mixed elements",
        {
            "E.1, 64 x 32 quadrilaterals": "bench statics-compression --elements 64",
            "E.2, 4 x 24 x 4 hexahedra": "bench statics-torsion --cell hexahedron --elements 4",
            "Cook, 64 x 64 quadrilaterals": "bench statics-cook --elements 64",
        },
    ),
    "thick-shells": (
        "Thick cylinder and sphere under inner pressure, mixed elements",
        {"32 elements": "bench thick-shells --cell both --refine 1"},
    ),
    "shells": ("Thin shells that turn far, solid-shell elements", {"": "bench shells"}),
    "hgo-strip": ("Strip of the HGO material", {"": "bench hgo-strip"}),
    "land": ("Land et al. 2015, problem 1", {"20 x 2 x 2": "bench land --problem 1 --elements 2"}),
    "compression": (
        "Compressed block, immersed (E.1)",
        {
            "16 x 8, 32 x 32": "bench compression --elements 16 --grid 32",
            "32 x 16, 64 x 64": "bench compression --elements 32 --grid 64",
            "16 x 8, 32 x 32, off": "bench compression --elements 16 --grid 32 --nu-stab off",
            "32 x 16, 64 x 64, off": "bench compression --elements 32 --grid 64 --nu-stab off",
            "32 x 16, 32 x 32": "bench compression --elements 32 --grid 32",
        },
    ),
    "cook-coarse": ("Cook, immersed", {"25 x 25": "bench cook --grid 25 --stabilised both"}),
    "torsion-coarse": ("Torsion, immersed", {"9 across": "bench torsion --grid 9 --stabilised both"}),
    "shell": ("Shell and membrane at rest", {"": "bench shell"}),
    "sphere": ("Soft sphere in a cavity", {"nodal": "bench sphere-in-cavity"}),
    "tube": ("Flow in a straight tube of held points, R = 12.5 mm, h = 1 mm, over 6 s", {"": "bench tube"}),
    "plate": (
        "Plates of solid shells, bspline3, span and wavelength 16 h, nodes half a spacing apart",
        {"": "bench plate"},
    ),
    "bending": ("Bending, stretching and twisting of a strip of solid-shell elements", {"": "bench bending"}),
    "cavity": (
        "Lid-driven cavity",
        {
            "Re 100, 64 x 64": "bench cavity --reynolds 100 --grid 64",
            "Re 1000, 128 x 128": "bench cavity --reynolds 1000 --grid 128",
        },
    ),
    "channel": ("Poiseuille and Womersley flow between open sides", {"": "bench channel"}),
    "taylor-green": ("Taylor-Green vortex, Re 1600", {"128^3": "bench taylor-green --grid 64"}),
    "refinement-block": (
        "Compressed block (E.1) on three grids, elements of one spacing",
        {
            "": "verify demos/compressed_block.toml --grids 2.5cm,1.6666667cm,1.25cm --set "
            "\"solid.block.mesh={shape='compressed_block',lower=[10,15],size=[20,10],elements=[16,8],load_width=10}\" "
            "--along solid.block.mesh.elements=[8,4],[12,6],[16,8] --steps 1,0.5 --also solid.block.kernel=ib4 "
            "--base 2.5cm"
        },
    ),
    "verify-channel": (
        "Pulsatile flow in a channel on three grids, 0 to 0.2 s",
        {
            "": 'verify valvefsi/cli/starts/channel/channel.toml --set "time.t_end=0.2 s" --set "time.dt=0.2 ms" '
            "--grids 0.625mm,0.3125mm,0.15625mm --base 0.3125mm --steps 1,0.5 --ranks 2 "
            "--also \"grid.upper=['6 cm','1 cm']\""
        },
    ),
    "verify-beam": (
        "Elastic beam in a channel on three grids that are alike, 0 to 0.4 s",
        {
            "": "verify calibration/verify_beam.toml --grids 0.625mm,0.3125mm,0.15625mm --base 0.3125mm "
            "--along solid.beam.mesh.elements=[4,16],[8,32],[16,64] --steps 1,0.5 --ranks 2 "
            "--also solid.beam.kernel=ib4 --also \"grid.upper=['4 cm','1 cm']\""
        },
    ),
    "sample-loop": (
        "Pulse duplicator with an orifice for the valve, uncertain circuit",
        {"": "sample calibration/sample_loop.toml"},
    ),
    "sample-valve": (
        "Opening of a valve, 0 to 100 ms, h = 2.4 mm, 20 runs",
        {"": "sample calibration/sample_valve.toml"},
    ),
    "fits": (
        "Fits of measured records",
        {
            "HGO, one family, free angle": "fit biaxial biaxial_valve_tissue.csv --model hgo --families 1",
            "HGO, two orthogonal families": "fit biaxial biaxial_valve_tissue.csv --model hgo --families 2",
            "three-element Windkessel": "fit windkessel left_heart_waveforms.csv --circuit downstream",
        },
    ),
}
"""Name of the results: title, and the command (without ``valvefsi``) behind each case."""

CASES = {
    "compression": "elements, cells",
    "refinement-block": "number",
    "verify-channel": "number",
    "verify-beam": "number",
    "sample-loop": "output",
    "sample-valve": "output",
}
"""What the names of the cases are, for the heading of a table."""
FILES = {"fit": "fit.json", "verify": "verification.json", "sample": "sample.json"}
"""What a command leaves its result in, where that is not ``result.json``."""
MOST = 100
"""Samples of a study up to which they are kept one by one."""
PARTS = ("inputs", "outputs")
FIT = {
    "half_sum_of_squares": "half sum of squares",
    "r_squared": "R2",
    "relative_l2": "relative L2",
    "relative_linf": "relative Linf",
}
"""Measures of a fit in ``fit.json``, and what they are called."""


def main(names: list[str]) -> None:
    """Run the named groups of commands, all where nothing is named."""
    for name in names or COMMANDS:
        title, cases = COMMANDS[name]
        runs, rows, environment, samples = [], [], {}, {}
        for case, command in cases.items():
            print(f"{name}: valvefsi {command}", flush=True)
            result = call(command)
            rows += [{"case": case} | row for row in quantities(result)]
            samples |= samples_of(result)
            environment = result.get("environment", environment)
            runs.append(
                {
                    "case": case,
                    "command": f"valvefsi {command}",
                    "parameters": result.get("parameters", {}) if "table" in result else {},
                    "wall_s": rounded(result.get("timing", {}).get("wall_s")),
                }
            )
        cases_are = {"cases": CASES[name]} if name in CASES else {}
        head = {"title": title, **cases_are, "origin": "run", "commit": commit(), **where(environment)}
        text = json.dumps(head | {"runs": runs, "quantities": rows} | samples, indent=1, ensure_ascii=False)
        (RESULTS / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def call(command: str) -> dict[str, Any]:
    """Run a command in a folder of its own and return its result."""
    words = shlex.split(command)
    data = Path(os.environ.get("VALVEFSI_DATA", "."))
    words = [str(data / word) if word.endswith(".csv") else word for word in words]
    with tempfile.TemporaryDirectory() as folder:
        arguments = [sys.executable, "-m", "valvefsi", *words, "--out", folder]
        subprocess.run(arguments, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        file = FILES.get(words[0], "result.json")
        return json.loads((Path(folder) / file).read_text(encoding="utf-8"))


def quantities(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a benchmark's table, of a study, or the parameters and norms of a fit."""
    if "grids" in result:
        return refined(result)
    if "outputs" in result:
        return sampled(result)
    if "table" in result:
        keys = ("quantity", "computed", "unit", "reference", "source")
        rows, above = [], ""
        for row in result["table"]:
            above = row["quantity"].strip() or above
            named = {key: rounded(row.get(key)) for key in keys} | {"quantity": above}
            rows.append({key: value for key, value in named.items() if value not in (None, "")})
        return rows
    rows = [
        {"quantity": name, "computed": rounded(result[key])} for key, name in FIT.items() if key in result
    ]
    return rows + [
        {"quantity": name, "computed": rounded(entry["value"]), "unit": entry["unit"].strip("-")}
        for name, entry in result["parameters"].items()
    ]


def refined(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a study of grids found of the numbers that change, and its changes of one thing."""
    names = {"order": "order", "extrapolated": "Richardson", "index": "GCI", "uncertainty": "uncertainty"}
    changes = {
        (row["quantity"], row["change"]): row["difference"] for row in result["changes"] if "base" in row
    }
    rows = []
    for row in result["quantities"]:
        if not row["quantity"].startswith("last.") or row["kind"] in ("unchanged", "no order"):
            continue
        case = {"case": row["quantity"].removeprefix("last.")}
        for grid, value in zip(result["grids"], row["values"], strict=True):
            rows.append({**case, "quantity": grid["member"], "computed": rounded(value)})
        for key, name in names.items():
            if row[key] is not None:
                rows.append({**case, "quantity": name, "computed": rounded(row[key])})
        for change in dict.fromkeys(change for _, change in changes):
            value = changes.get((row["quantity"], change))
            rows.append({**case, "quantity": f"change by {change}", "computed": rounded(value)})
    return rows


def sampled(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Return distribution, the surrogate's error and total indices of the outputs of a study of uncertain inputs."""
    rows = []
    for row in result["outputs"]:
        case = {"case": row["output"].removeprefix("last.")}
        for key, name in {"mean": "mean", "std": "std", "low": "2.5 %", "high": "97.5 %"}.items():
            rows.append({**case, "quantity": name, "computed": rounded(row[key])})
        if "surrogate_relative_error" in row:
            missed = {"computed": rounded(100 * row["surrogate_relative_error"]), "unit": "%"}
            rows.append({**case, "quantity": "variance missed by the surrogate", **missed})
        for one in row["indices"]:
            low, high = one["total_interval"]
            rows.append({**case, "quantity": f"S_T {one['group']}", "computed": round(one["total"], 3)})
            rows.append({**case, "quantity": f"+- {one['group']}", "computed": round((high - low) / 2, 3)})
    return rows


def samples_of(result: dict[str, Any]) -> dict[str, Any]:
    """Return the samples of a study themselves, by columns: how each ended, its inputs and outputs."""
    members = result.get("members", {})
    if not 0 < len(members.get("sample", ())) <= MOST:
        return {}
    kept = {kind: {n: [rounded(v) for v in values] for n, values in members[kind].items()} for kind in PARTS}
    return {"samples": {key: members[key] for key in ("state", "reason")} | kept}


def rounded(value: object) -> object:
    """Return a number with six digits, anything else as it is."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def where(environment: dict[str, Any]) -> dict[str, Any]:
    """Return version, date, ranks, cores and what it ran with."""
    import datetime

    from valvefsi import __version__

    return {
        "version": __version__,
        "date": str(environment.get("date", datetime.datetime.now(datetime.UTC).isoformat()))[:10],
        "ranks": environment.get("ranks", 1),
        "cores": os.cpu_count(),
        "versions": environment.get("versions", {}),
    }


def commit() -> str:
    """Return the commit that is checked out."""
    command = ["git", "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    main(sys.argv[1:])
