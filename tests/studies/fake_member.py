"""Stands in for ``python -m valvefsi`` where only what the runner of a study does is asked: a run of twenty rows.

The viscosity says what becomes of it: 7 fails, 9 is killed, 5 waits at a quarter until ``go`` lies in the folder above.
Where ``deaf`` lies there, it does not stop when asked to; where ``broken`` does, it fails.
Its checkpoint is ``checkpoint.vfc`` of the folder above. What it was called with, and when, stands in ``events``
there.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

ROWS = 20


def main() -> None:
    """Run."""
    words = sys.argv[1:]
    out = Path(words[words.index("--out") + 1])
    values = dict(text.split("=", 1) for flag, text in itertools.pairwise(words) if flag == "--set")
    viscosity, t_end = float(values["fluid.viscosity"]), float(values.get("time.t_end", "1"))
    told = {"name": out.name, "resume": "--resume" in words, "pid": os.getpid(), "env": dict(os.environ)}
    say(out, {"begin": told})
    stopped = []
    deaf = (out.parent / "deaf").exists()
    signal.signal(signal.SIGTERM, signal.SIG_IGN if deaf else lambda *_: stopped.append(True))
    if (out.parent / "broken").exists():
        sys.exit("error: it is broken")
    if viscosity == 7.0:
        print("warning: about to fail")
        sys.exit("ConvergenceError: it does not converge")
    if viscosity == 9.0:
        os.kill(os.getpid(), signal.SIGKILL)
    history = out / "history.csv"
    if "--resume" not in words:
        history.write_text("step,t_s,u_x_tip_cm\n")
    for step in range(len(history.read_text().splitlines()), ROWS + 1):
        with history.open("a") as file:
            file.write(f"{step},{step * t_end / ROWS},{viscosity * step}\n")
        while viscosity == 5.0 and step == ROWS // 4 and not (out.parent / "go").exists() and not stopped:
            time.sleep(0.01)
        if stopped:
            (out / "checkpoints").mkdir(exist_ok=True)
            shutil.copy(out.parent / "checkpoint.vfc", out / "checkpoints" / "step_00000005.vfc")
            say(out, {"stop": told})
            sys.exit(143)
    wait_for_others(out)
    last = {"step": float(ROWS), "t_s": t_end, "u_x_tip_cm": viscosity * ROWS}
    (out / "summary.json").write_text(
        json.dumps({"last": last, "timing": {"steps": ROWS, "note": "the same"}})
    )
    say(out, {"end": told})


def wait_for_others(out: Path) -> None:
    """Wait until as many have begun as the file ``together`` of the folder above says."""
    together = out.parent / "together"
    while together.exists() and (out.parent / "events").read_text().count('"begin"') < int(
        together.read_text()
    ):
        time.sleep(0.01)


def say(out: Path, event: dict[str, object]) -> None:
    """Add a line to the events."""
    with (out.parent / "events").open("a") as file:
        file.write(json.dumps(event) + "\n")


if __name__ == "__main__":
    main()
