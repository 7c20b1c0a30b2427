"""Folders of results as commands leave them, made without running anything, and a page as it is parsed."""

from __future__ import annotations

import json
from html.parser import HTMLParser

import numpy as np
from mpi4py import MPI

from tests.case.test_valve_runs import run_folder
from tests.valve_waves import PERIOD
from valvefsi.case import load_case
from valvefsi.case.valve_report import report_valve
from valvefsi.io.paraview import FluidSeries
from valvefsi.io.solid_body import Body, write_body

FRAMES = 5
FLUID = (4, 3, 6)


class Parsed(HTMLParser):
    """What a page holds: tags with their attributes, tables with their cells, and all of its text."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.tables, self.text, self.open = [], [], [], []
        self.cell = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        named = dict(attributes)
        self.tags.append((tag, named))
        if tag not in ("meta", "img", "input", "br", "link"):
            self.open.append(tag)
        if tag == "table":
            self.tables.append({"caption": "", "rows": [], "scopes": []})
        elif tag == "tr":
            self.tables[-1]["rows"].append([])
        elif tag in ("th", "td"):
            self.cell = {"text": "", "value": None, "tag": tag}
            self.tables[-1]["rows"][-1].append(self.cell)
            if tag == "th":
                self.tables[-1]["scopes"].append(named.get("scope"))
        elif tag == "data" and self.cell is not None:
            self.cell["value"] = float(named["value"])

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag
        if tag in ("th", "td"):
            self.cell = None

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)
            if self.cell is not None:
                self.cell["text"] += data
            elif "caption" in self.open:
                self.tables[-1]["caption"] += data

    @property
    def words(self):
        """All text of the page."""
        return " ".join(" ".join(self.text).split())

    def table(self, caption):
        """The table with this caption."""
        return next(table for table in self.tables if table["caption"].startswith(caption))

    def column(self, caption, heading):
        """Cells of a column by the first cell of their row."""
        head, *rows = self.table(caption)["rows"]
        k = [cell["text"] for cell in head].index(heading)
        return {row[0]["text"]: row[k] for row in rows}


def valve_folder(folder, **options):
    """The folder of a run of a valve with frames, numbers and warnings."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = run_folder(folder, 2.0, **options)
    case = load_case(made / "case.toml")
    history = np.loadtxt(made / "history.csv", delimiter=",", skiprows=1)
    header = (made / "history.csv").read_text().splitlines()[0]
    columns = f"{header},leaflets_volume_change_percent"
    np.savetxt(
        made / "history.csv", np.pad(history, ((0, 0), (0, 1))), delimiter=",", header=columns, comments=""
    )
    summary = {
        "last": {"step": 1000.0, "t_s": 2.0 * PERIOD, "pdva_cm2": 0.25},
        "timing": {
            "steps": 1000,
            "wall_s": 12.5,
            "phases": {"advection": 9.0, "output": 1.0},
            "recoveries": [
                {"t_s": 0.1, "step": 60, "dt_s": 1e-5, "reason": "the Courant number is 1.5 > 0.5"}
            ],
            "warnings": [{"solid": "leaflets", "text": "fluid may leak through <leaflets>"}],
        },
        "energy": {"kinetic_erg": 1234.5, "pressures_erg": 2e5, "residual_percent": -0.75},
    }
    (made / "summary.json").write_text(json.dumps(summary | report_valve(case, made)))
    add_frames(made, 2.0 * PERIOD)
    return made


def add_frames(folder, t_end):
    """Frames of leaflets that open and of a fluid, and a housing that stays."""
    times = np.linspace(0.0, t_end, FRAMES)
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    block = np.concatenate([square, square + [0, 0, 0.2]]) * [0.8, 0.5, 1.0]
    for k in range(FRAMES):
        moved = block + [0.0, 0.0, 0.3 * k]
        values = {
            "J": 1.0 + 0.01 * k * np.arange(8.0),
            "von Mises stress [dyn/cm^2]": 1e4 * k * np.arange(8.0),
        }
        cells = {12: np.arange(8).reshape(1, 8)}
        body = Body(points=moved, cells=cells, reference=block, values={"J": values["J"]})
        write_body(folder / "paraview" / "leaflets" / f"leaflets_{k:06d}.vtu", body)
        write_body(
            folder / "paraview" / "leaflets_stress" / f"leaflets_stress_{k:06d}.vtu",
            Body(points=moved, cells=cells, reference=block, values=values),
        )
    for name in ("leaflets", "leaflets_stress"):
        items = "".join(
            f'<DataSet timestep="{t!r}" file="{name}/{name}_{k:06d}.vtu"/>'
            for k, t in enumerate(times.tolist())
        )
        (folder / "paraview" / f"{name}.pvd").write_text(
            f"<VTKFile><Collection>{items}</Collection></VTKFile>"
        )
    write_body(
        folder / "paraview" / "housing.vtu",
        Body(points=2.0 * square - 0.5, cells={9: np.arange(4).reshape(1, 4)}),
    )
    box = ((-1.0, -1.0, -1.0), (0.5, 0.7, 0.5))
    fluid = FluidSeries(folder / "paraview", "fluid", MPI.COMM_SELF, FLUID, (0, 0, 0), FLUID, box)
    for k, t in enumerate(times.tolist()):
        velocity = np.zeros((*FLUID, 3))
        velocity[..., 2] = k + np.arange(FLUID[0])[:, None, None] + 10.0 * np.arange(FLUID[2])
        fluid.write(t, velocity, np.zeros(FLUID))


def fit_folder(folder):
    """The folder of a fit, as small as it can be."""
    folder.mkdir(parents=True)
    parameters = {
        "R_p": {
            "value": 1.25,
            "unit": "mmHg*s/ml",
            "std": 0.01,
            "ci95": [1.23, 1.27],
            "verdict": "identified",
        }
        | {"ci95_method": "profile likelihood"},
        "C": {"value": 0.9, "unit": "ml/mmHg", "std": None, "ci95": None, "verdict": "held"},
    }
    fit = {"kind": "windkessel", "model": "downstream", "parameters": parameters, "r_squared": 0.99}
    fit |= {
        "notes": ["warning: few starts <b>reached</b> the best"],
        "data": [{"file": "loop.csv", "sha256": "ab12"}],
    }
    (folder / "fit.json").write_text(json.dumps(fit))
    return folder


def benchmark_folder(folder):
    """The folder of a benchmark."""
    folder.mkdir(parents=True)
    row = {
        "quantity": "drag",
        "computed": 3.1,
        "reference": 3.0,
        "difference_percent": 10 / 3,
        "unit": "-",
        "source": "S",
    }
    result = {"benchmark": "cylinder", "parameters": {"h": 0.1}, "timing": {"wall_s": 2.0}, "table": [row]}
    (folder / "result.json").write_text(json.dumps(result))
    return folder


def sweep_folder(folder):
    """The folder of a sweep of which one member failed."""
    folder.mkdir(parents=True)
    members = [
        {
            "member": f"kappa={k}",
            "state": state,
            "message": said,
            "wall_s": 1.0,
            "row": {"kappa": float(k), "last.t_s": t},
        }
        for k, state, said, t in ((1, "done", "", 0.5), (2, "failed", "it <broke> down", None))
    ]
    sweep = {
        "case": "porcine.toml",
        "version": "0.1.0",
        "over": {"solid.kappa": {"values": ["1", "2"], "column": "kappa"}},
    }
    (folder / "sweep.json").write_text(json.dumps(sweep | {"members": members}))
    return folder


def grids_folder(folder, *, notes=()):
    """The folder of a study of three grids of a valve, one of which failed, and of the finest with another kernel."""
    names = {"h=2mm": 0.2, "h=1mm": 0.1, "h=0.5mm": 0.05, "h=0.5mm,kernel=ib4": 0.05}
    for name, h in names.items():
        valve_folder(folder / name)
        record = {"member": name, "overrides": [f"grid.h={h} cm"], "state": "done", "wall_s": 3.0}
        (folder / name / "member.json").write_text(json.dumps(record))
    row = {
        "quantity": "last.u_cm",
        "values": [3.4, 3.2, 3.1],
        "kind": "monotone",
        "order": 1.0,
        "index": 0.04,
    }
    row |= {"extrapolated": 3.0, "uncertainty": 0.125, "text": "order 1.00, index 4.03 %"}
    time = {
        "quantity": "last.at_s",
        "values": [0.1, 0.2, 0.1],
        "kind": "no order",
        "order": None,
        "index": None,
    }
    time |= {"extrapolated": None, "uncertainty": None, "text": "no order: a <time> of an event"}
    wave = {"quantity": "p_z_lower_mmHg", "norm": "L2", "differences": [0.2, 0.1], "kind": "monotone"}
    wave |= {"order": 1.0, "index": 0.125, "uncertainty": 0.13, "text": "order 1.00"}
    kinds = ("time step", "NOT VARIED: --steps does"), ("kernel", "varied")
    of = [
        {
            "of": of,
            "meaning": f"of the {of}",
            "changes": ["solid.x.kernel=ib4"] * (said == "varied"),
            "text": said,
        }
        | {"number": "last.u_cm", "number_percent": 0.5, "waveform": None, "waveform_percent": None}
        for of, said in kinds
    ]
    change = {"quantity": "last.u_cm", "change": "solid.x.kernel=ib4", "difference_percent": 0.5}
    beat = {
        "quantity": "peak_flow_ml_per_s",
        "values": [400.0, 404.0, 405.0],
        "error": 0.3333,
        "error_percent": 0.08,
    }
    result = {
        "case": "porcine.toml",
        "version": "0.2.0",
        "grids": [{"member": name, "h_cm": h, "dt_s": 1e-4} for name, h in list(names.items())[:3]],
        "expected_order": 1.0,
        "base": "h=0.5mm",
        "notes": ["the time step is <the same>", *notes],
        "failed": {"h=0.4mm": "it <broke> down"},
        "quantities": [row, time],
        "waveforms": [wave, {**wave, "quantity": "courant", "kind": "no order"}],
        "changes": [change],
        "time_steps": [{**row, "factors": [1.0, 0.5, 0.25]}],
        "dependence": of,
        "iterations": {"solves": "direct", "beats": [beat], "text": "of beats"},
    }
    (folder / "verification.json").write_text(json.dumps(result))
    return folder


def sample_folder(folder, *, runs=True):
    """The folder of three samples of two inputs, the last of which failed."""
    for number in range(2 if runs else 0):
        valve_folder(folder / f"s{number:04d}")
    folder.mkdir(exist_ok=True)
    index = {
        "group": "mu",
        "first": 0.7,
        "first_interval": [0.6, 0.8],
        "total": 0.9,
        "total_interval": [0.75, 1.05],
    }
    poor = "polynomial chaos; it misses 40 % of the variance: DO NOT TRUST these indices"
    output = {"output": "u_cm", "count": 2, "mean": 1.5, "std": 0.25, "median": 1.4, "low": 1.1, "high": 1.9}
    result = {
        "title": "tolerances <of> a valve",
        "study": "study.toml",
        "case": "porcine.toml",
        "target": "case" if runs else "circuit",
        "version": "0.2.0",
        "changes": [],
        "samples": 3,
        "design": {"method": "latin-hypercube", "size": 3, "seed": 0},
        "groups": {"mu": ["mu"]},
        "inputs": [
            {"name": "mu", "key": "fluid.viscosity", "unit": "cP", "from": "uniform: low 1 cP, high 3 cP"}
        ],
        "failed": {"2": "it <broke> down"},
        "notes": ["1 of 3 samples FAILED and are in no number"],
        "outputs": [{**output, "text": poor, "indices": [index]}],
        "members": {
            "sample": [0, 1, 2],
            "state": ["done", "done", "failed"],
            "reason": ["", "", "it <broke> down"],
            "inputs": {"mu": [1.25, 2.5, 3.0]},
            "outputs": {"u_cm": [1.25, 1.75, None]},
        },
    }
    (folder / "sample.json").write_text(json.dumps(result))
    return folder


def validation_folder(folder):
    """The folder of a validation whose last stage has been made."""
    (folder / "compare").mkdir(parents=True)
    norms = {"l2_percent": 4.5, "linf_percent": 9.0, "nrmse_percent": 2.0}
    pair = {
        "a": {"name": "run-1mm"},
        "b": {"name": "record"},
        "quantities": {"p_lv": {"as_they_are": norms, "shifted": norms}},
    }
    check = {
        "run": "run-1mm",
        "quantity": "p_lv",
        "norm": "l2_percent",
        "at_most": 3.4,
        "found": 4.5,
        "found_shifted": 4.5,
    }
    check |= {"reached": False, "against": "target"}
    verdict = {
        "title": "porcine",
        "checks": [check],
        "against_record": [pair],
        "next": ["raise max_beats"],
        "stages": {},
    }
    (folder / "compare" / "verdict.json").write_text(json.dumps(verdict))
    (folder / "compare" / "stage.json").write_text("{}")
    return folder
