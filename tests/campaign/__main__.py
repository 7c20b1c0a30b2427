"""Run the campaign: ``python -m tests.campaign [--seed 1] [--only cases,kills] [--share 0.1] [--out table.json]``."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.campaign.processes import ROOT, attack, jobs, prepare
from valvefsi import __version__

COUNTS = {"cases": 500, "csv": 500, "meshes": 200, "folders": 200, "kills": 50}
WORKER = """
import json, sys
from pathlib import Path
from tests.campaign.fuzz import one
kind, seed, first, count, folder = sys.argv[1:]
for number in range(int(first), int(count)):
    print(json.dumps([number, "begun"]), flush=True)
    print(json.dumps([number, one(kind, int(seed), number, Path(folder))]), flush=True)
"""
GOOD = (
    "refused",
    "accepted",
    "resumed",
    "run failed in",
    "kill -9",
    "full disk",
    "stopped and",
    "clock that",
)
BAD = ("failed:", "another answer", "torn", "hung", "not one line")


def fuzz(kind: str, seed: int, count: int, folder: Path) -> Counter[str]:
    """Return how often what came of the items; a process that dies goes on after the item that it died of."""
    outcomes: dict[int, str] = {}
    first = 0
    while first < count:
        command = [sys.executable, "-c", WORKER, kind, str(seed), str(first), str(count), str(folder)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        ) as worker:
            for line in worker.stdout or ():
                if line.startswith("["):
                    number, outcome = json.loads(line)
                    outcomes[number] = outcome
                    first = number + 1
        if worker.returncode != 0 and first == 0:
            raise RuntimeError("the worker does not begin")
        if outcomes[first - 1] == "begun":
            outcomes[first - 1] = f"CRASH: exit {worker.returncode}"
    for number, outcome in sorted(outcomes.items()):
        if outcome.split(":")[0].isupper():
            print(f"{kind} {number}: {outcome}", file=sys.stderr)
    return Counter(outcome.split(":")[0] for outcome in outcomes.values())


def kills(place: Path, chosen: str, count: int, given: argparse.Namespace) -> None:
    """Attack the processes whose name holds a text, and keep the counts after each attack."""
    for number, job in enumerate(jobs(place)):
        if chosen not in job.name:
            continue
        prepare(job, place)
        found: Counter[str] = Counter()
        for outcome in attack(job, place / str(number), count, given.seed):
            found[outcome] += 1
            print(f"{time.strftime('%H:%M:%S')} {job.name}: {outcome}", flush=True)
            keep(given.out, {job.name: found}, given)
        given.table[job.name] = found


def keep(out: Path | None, table: Mapping[str, Mapping[str, int]], given: argparse.Namespace) -> None:
    """Put counts into a file of results; what it holds of other attacks stays."""
    if out is None:
        return
    old: dict[str, Any] = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    command = f"python -m tests.campaign --seed {given.seed}"
    rows = [row for row in old.get("quantities", []) if row["case"] not in table]
    rows += [
        {"case": case, "quantity": outcome, "computed": times}
        for case, found in table.items()
        for outcome, times in sorted(found.items())
    ]
    runs = [run for run in old.get("runs", []) if run["case"] not in table]
    runs += [{"case": case, "command": command} for case in table]
    commits = sorted({*old.get("commit", "").split(", "), commit()} - {""})
    result = {
        "title": "Campaign of attacks",
        "cases": "attack",
        "origin": "run",
        "commit": ", ".join(commits),
        "version": __version__,
        "date": time.strftime("%Y-%m-%d"),
        "ranks": 1,
        "cores": os.cpu_count(),
        "runs": runs,
        "quantities": rows,
    }
    out.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def commit() -> str:
    """Return the commit that is checked out."""
    command = ["git", "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def main() -> int:
    """Run what is asked for, print the table, and fail where anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default=",".join(COUNTS), help="parts, of " + ", ".join(COUNTS))
    parser.add_argument("--job", default="", help="only the processes whose name holds this")
    parser.add_argument("--share", type=float, default=1.0, help="part of the counts")
    parser.add_argument("--out", type=Path, default=None, help="file of results that the counts are put into")
    given = parser.parse_args(namespace=argparse.Namespace(table={}))
    with tempfile.TemporaryDirectory(prefix="campaign") as place:
        for kind in given.only.split(","):
            count = max(1, round(given.share * COUNTS[kind]))
            if kind == "kills":
                kills(Path(place), given.job, count, given)
            else:
                given.table[kind] = fuzz(kind, given.seed, count, Path(place))
                keep(given.out, {kind: given.table[kind]}, given)
    rows = [(case, *entry) for case, found in given.table.items() for entry in sorted(found.items())]
    print("| attack | outcome | times |\n|---|---|---|")
    for row in rows:
        print("| {} | {} | {} |".format(*row))
    bad = [row for row in rows if not row[1].startswith(GOOD) or any(word in row[1] for word in BAD)]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
