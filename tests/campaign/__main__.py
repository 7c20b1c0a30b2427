"""Run the campaign: ``python -m tests.campaign [--seed 1] [--only cases,kills] [--share 0.1] [--out table.md]``."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.campaign.processes import ROOT, attack, jobs

COUNTS = {"cases": 500, "csv": 500, "meshes": 200, "folders": 200, "kills": 50}
PATIENCE = 120.0
WORKER = """
import json, sys
from pathlib import Path
from tests.campaign.fuzz import one
kind, seed, first, count, folder = sys.argv[1:]
for number in range(int(first), int(count)):
    print(json.dumps([number, "begun"]), flush=True)
    print(json.dumps([number, one(kind, int(seed), number, Path(folder))]), flush=True)
"""


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


def main() -> int:
    """Run what is asked for, print the table, and fail where anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default=",".join(COUNTS), help="parts, of " + ", ".join(COUNTS))
    parser.add_argument("--share", type=float, default=1.0, help="part of the counts")
    parser.add_argument("--out", type=Path, default=None, help="file of the table")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="campaign") as place:
        for kind in given.only.split(","):
            count = max(1, round(given.share * COUNTS[kind]))
            if kind == "kills":
                for number, job in enumerate(jobs(Path(place))):
                    found = attack(job, Path(place) / str(number), count, given.seed)
                    rows += [(job.name, outcome, times) for outcome, times in found.items()]
            else:
                found = fuzz(kind, given.seed, count, Path(place))
                rows += [(kind, outcome, times) for outcome, times in sorted(found.items())]
    lines = [
        "| attack | outcome | times |",
        "|---|---|---|",
        *("| {} | {} | {} |".format(*row) for row in rows),
    ]
    print("\n".join(lines))
    if given.out is not None:
        given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    good = (
        "refused",
        "accepted",
        "resumed",
        "run failed in",
        "kill -9",
        "full disk: one line",
        "stopped and",
    )
    bad = [
        row
        for row in rows
        if not row[1].startswith(good) or "failed:" in row[1] or "another answer" in row[1]
    ]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
