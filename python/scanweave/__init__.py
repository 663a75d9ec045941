"""Registration of unordered, partially overlapping 3-D scans.

>>> import scanweave
>>> room = scanweave.synthetic_interior(scans=4)
>>> scanweave.register(room.scans)
Result(4 of 4 scans placed, components: 1)

Poses are ``target_from_source`` matrices of shape (4, 4); the pose of a scan is ``world_from_scan``.
Lengths are metres. The order of scans carries no meaning. :mod:`scanweave.ray` registers on a Ray cluster.
"""

from ._api import (
    ConfigLike,
    config,
    describe,
    predict_overlap,
    read_scan,
    read_scans,
    register,
    register_pair,
    synthetic_interior,
)
from ._errors import InputError, OutputError, ReadError, ScanweaveError, ScanweaveWarning, SettingError
from ._evaluation import Evaluation, evaluate
from ._inputs import ScanLike, ScansLike
from ._outcomes import Evidence, Neighbour, Outcome
from ._records import Features, Overlap, RegisteredPair, SyntheticScans
from ._result import Cloud, PoseEdge, PoseGraph, Result
from ._scanweave import Config, Scan, __version__

__all__ = [
    "Cloud",
    "Config",
    "ConfigLike",
    "Evaluation",
    "Evidence",
    "Features",
    "InputError",
    "Neighbour",
    "Outcome",
    "OutputError",
    "Overlap",
    "PoseEdge",
    "PoseGraph",
    "ReadError",
    "RegisteredPair",
    "Result",
    "Scan",
    "ScanLike",
    "ScansLike",
    "ScanweaveError",
    "ScanweaveWarning",
    "SettingError",
    "SyntheticScans",
    "__version__",
    "config",
    "describe",
    "evaluate",
    "predict_overlap",
    "read_scan",
    "read_scans",
    "register",
    "register_pair",
    "synthetic_interior",
]
