"""Registers a synthetic room, and the scans of a folder where one is named: ``python quickstart.py [SCANS]``."""

import sys

import scanweave

room = scanweave.synthetic_interior(scans=5, seed=4)
result = scanweave.register(room.scans, seed=0, progress=True)
print(result, scanweave.evaluate(result, room.truth).recall)
for folder in sys.argv[1:]:
    result = scanweave.register(folder, seed=0, progress=True)
    print(result, result.declined)
    print("open", result.save("result", force=True) / "report.html")
