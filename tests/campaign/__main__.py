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
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from tests.campaign.chains import kill_in_chains
from tests.campaign.outcomes import Log, columns, is_bad
from tests.campaign.processes import ROOT, Job, attack, jobs, prepare
from tests.campaign.warm import Warm
from valvefsi import __version__

COUNTS = {"cases": 500, "csv": 500, "meshes": 200, "folders": 200, "kills": 50, "faults": 1}
WORKER = """
import json, sys
from pathlib import Path
from tests.campaign.fuzz import one
kind, seed, first, count, folder = sys.argv[1:]
for number in range(int(first), int(count)):
    print(json.dumps([number, "begun"]), flush=True)
    print(json.dumps([number, one(kind, int(seed), number, Path(folder))]), flush=True)
"""


def fuzz(kind: str, count: int, folder: Path, seed: int, log: Log) -> Counter[str]:
    """Return how often what came of the items; a process that dies goes on after the item that it died of."""
    outcomes = {number: said[0] for number, said in log.read(kind).items()}
    first = len(outcomes)
    while first < count:
        last = first
        command = [sys.executable, "-c", WORKER, kind, str(seed), str(first), str(count), str(folder)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
        ) as worker:
            for line in worker.stdout or ():
                if line.startswith("["):
                    number, outcome = json.loads(line)
                    outcomes[number] = outcome
                    first = number + 1
                    if outcome != "begun":
                        log.add(kind, number, [outcome])
        if worker.returncode != 0 and first == last:
            raise RuntimeError("the worker does not begin")
        if outcomes[first - 1] == "begun":
            outcomes[first - 1] = f"CRASH: exit {worker.returncode}"
            log.add(kind, first - 1, [outcomes[first - 1]])
    for number, outcome in sorted(outcomes.items()):
        if is_bad(outcome):
            print(f"{kind} {number}: {outcome}", file=sys.stderr)
    return columns(outcomes.values())


def chosen_jobs(place: Path, chosen: str) -> Iterator[tuple[Job, Path]]:
    """Prepare the processes whose name holds a text, each with a folder of its own."""
    for number, job in enumerate(jobs(place)):
        if chosen in job.name:
            prepare(job, place)
            yield job, place / str(number)


def kills(place: Path, count: int, given: argparse.Namespace, log: Log) -> None:
    """Kill the chosen processes, and keep the counts after each chain of kills."""
    with closing(Warm()) as warm:
        for job, folder in chosen_jobs(place, given.job):
            chains = log.read(job.name)
            found = Counter(outcome for chain in chains.values() for outcome in chain)
            rest = count - found.total()
            for chain in (
                kill_in_chains(job, warm, folder, rest, given.seed, first=len(chains)) if rest else ()
            ):
                log.add(job.name, len(chains), chain)
                chains[len(chains)] = chain
                found.update(chain)
                print(f"{time.strftime('%H:%M:%S')} {job.name}: {chain}", flush=True)
                keep(given.out, {job.name: found}, given)
            given.table[job.name] = found


def faults(place: Path, given: argparse.Namespace, log: Log) -> None:
    """Fill the disk of the chosen processes, stop them, let their clocks jump; keep the counts after each."""
    for job, folder in chosen_jobs(place, given.job):
        name, found = f"{job.name}, surroundings", Counter[str]()
        for number, outcome in enumerate(attack(job, folder, given.seed)):
            log.add(name, number, [outcome])
            found[outcome] += 1
            print(f"{time.strftime('%H:%M:%S')} {job.name}: {outcome}", flush=True)
            keep(given.out, {name: found}, given)
        given.table[name] = found


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
    parser.add_argument(
        "--log", type=Path, default=None, help="file of outcomes; what it holds is not done again"
    )
    given = parser.parse_args(namespace=argparse.Namespace(table={}))
    log = Log(given.log, given.seed)
    with tempfile.TemporaryDirectory(prefix="campaign") as place:
        for kind in given.only.split(","):
            count = max(1, round(given.share * COUNTS[kind]))
            if kind == "kills":
                kills(Path(place), count, given, log)
            elif kind == "faults":
                faults(Path(place), given, log)
            else:
                name = f"{kind}, seed {given.seed}"
                given.table[name] = fuzz(kind, count, Path(place), given.seed, log)
                keep(given.out, {name: given.table[name]}, given)
    rows = [(case, *entry) for case, found in given.table.items() for entry in sorted(found.items())]
    print("| attack | outcome | times |\n|---|---|---|")
    for row in rows:
        print("| {} | {} | {} |".format(*row))
    return 1 if any(times and is_bad(outcome) for _, outcome, times in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
