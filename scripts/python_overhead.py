#!/usr/bin/env python3
"""Time of a registration by the Python package beside that by the command, in pairs that alternate.

Each run is a process of its own that reads the scans, registers them and writes the result; the command's
is the binary that cargo builds. Run it on an idle machine, in an environment with the package.

usage: scripts/python_overhead.py BINARY SCANS [PAIRS]
"""

import filecmp
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCRIPT = """
import sys, scanweave
scans, out = sys.argv[1:]
scanweave.register(scans, cache=out + "/cache").save(out)
"""


def seconds(command: "list[str]") -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def main() -> None:
    binary, scans, pairs = sys.argv[1], sys.argv[2], int((sys.argv[3:] or ["5"])[0])
    ratios, times = [], []
    for pair in range(pairs):
        with tempfile.TemporaryDirectory() as place:
            runs = {
                "command": [binary, "register", scans, "-o", f"{place}/command"],
                "package": [sys.executable, "-c", SCRIPT, scans, f"{place}/package"],
            }
            order = list(runs) if pair % 2 == 0 else list(runs)[::-1]
            taken = {name: seconds(runs[name]) for name in order}
            for name in ("poses.json", "merged.ply", "overlap.csv", "config.toml"):
                same = filecmp.cmp(Path(place, "command", name), Path(place, "package", name), shallow=False)
                if not same:
                    sys.exit(f"{name} differs")
        times.append(taken)
        ratios.append(taken["package"] / taken["command"])
        print(f"{taken['command']:.2f} s command, {taken['package']:.2f} s package: {ratios[-1]:.3f}", flush=True)
    print(f"median ratio {statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f}), same bytes in all")
    start = seconds([sys.executable, "-c", "import scanweave"])
    print(f"import alone {start:.2f} s")


if __name__ == "__main__":
    main()
