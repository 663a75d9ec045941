#!/usr/bin/env python3
"""Time of a registration by the Python package beside that by the command, in pairs that alternate.

Each run is a process of its own that reads the scans, registers them and writes the result; the command's
is the binary that cargo builds. Run it on an idle machine, in an environment with the package.

usage: scripts/python_overhead.py BINARY SCANS [PAIRS]
"""

import filecmp
import resource
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


def seconds(command: "list[str]") -> "tuple[float, float]":
    """Seconds of the clock, and of all processors together."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    before, start = used.ru_utime + used.ru_stime, time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.perf_counter() - start, used.ru_utime + used.ru_stime - before


def main() -> None:
    binary, scans, pairs = sys.argv[1], sys.argv[2], int((sys.argv[3:] or ["5"])[0])
    ratios: "list[tuple[float, ...]]" = []
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
        (wall, cpu), (wall_of_package, cpu_of_package) = taken["command"], taken["package"]
        ratios.append((wall_of_package / wall, cpu_of_package / cpu))
        shown = f"{wall:.2f} s command, {wall_of_package:.2f} s package, of processors {cpu:.2f} and {cpu_of_package:.2f}"
        print(shown, flush=True)
    for what, column in zip(("seconds", "processor seconds"), zip(*ratios)):
        middle = statistics.median(column)
        print(f"package / command, {what}: median {middle:.3f} ({min(column):.3f} to {max(column):.3f})")
    print("same bytes in all pairs")
    print(f"import alone {seconds([sys.executable, '-c', 'import scanweave'])[0]:.2f} s")


if __name__ == "__main__":
    main()
