"""Results against truth."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Optional, Union

from numpy.typing import ArrayLike

from ._errors import input_error
from ._inputs import matrix
from ._result import Result
from ._scanweave import evaluate_poses


@dataclass(frozen=True)
class Evaluation:
    """Which pairs and scans of a result are right.

    Attributes
    ----------
    recall : float or None
        Pairs with a right relative pose, of all pairs of scans; pairs with a declined scan, or with
        scans of different components, count as missed.
    judged_pairs, right_pairs, wrong_pairs : int
        All pairs; those within the limits; those in one component and beyond them.
    placed, total : int
        Scans with a pose, and all.
    wrongly_placed : list of str
        Scans most of whose pairs within their component are wrong.
    median_rotation_deg, max_rotation_deg, median_translation_m, max_translation_m : float
        Errors of the relative poses of all pairs in one component, at the centre of the source where
        the result states it; 0 without a pair.
    registration_recall : float or None
        Recall by ``gt.log`` and ``gt.info`` of a benchmark (3DMatch, 3DLoMatch, ETH), where one was named.
    """

    recall: Optional[float]
    judged_pairs: int
    right_pairs: int
    wrong_pairs: int
    placed: int
    total: int
    wrongly_placed: list[str]
    median_rotation_deg: float
    max_rotation_deg: float
    median_translation_m: float
    max_translation_m: float
    registration_recall: Optional[float]


Truth = Union[Mapping[str, ArrayLike], str, "os.PathLike[str]"]


def evaluate(
    result: Union[Result, Mapping[str, Optional[ArrayLike]]],
    truth: Truth,
    *,
    max_translation_m: Optional[float] = None,
    max_rotation_deg: float = 5.0,
    benchmark: Union[str, os.PathLike[str], None] = None,
    threshold_m: float = 0.2,
) -> Evaluation:
    """Compare poses with true ones.

    Parameters
    ----------
    result : Result, or dict of str to array of shape (4, 4) or None
        A registration, or ``world_from_scan`` poses of any program, all in one frame.
    truth : dict of str to array of shape (4, 4), or path
        True ``world_from_scan`` of every scan, in any one frame; or a folder of the scans with their true
        poses (truth.json, ``<scan>.info.txt``, …) for a :class:`Result`.
    max_translation_m, max_rotation_deg : float
        Largest errors of a right pair. Default of the first: three inlier radii of the result.
    benchmark : path, optional
        Folder with gt.log and gt.info, whose scans are numbered as the names of the scans end.
    threshold_m : float
        Largest error of a registered pair of the benchmark, metres: 0.2 for 3DMatch, 0.5 for ETH.
    """
    names = result.names if isinstance(result, Result) else list(result)
    folder = os.fspath(truth) if isinstance(truth, (str, os.PathLike)) else None
    motions = None
    if not isinstance(truth, (str, os.PathLike)):
        missing = [name for name in names if name not in truth]
        if missing:
            found = f"no true pose for {', '.join(map(repr, missing[:3]))}"
            raise input_error("truth", found, "a true pose for every scan", "add it, or leave the scan out")
        motions = [matrix(truth[name], f"truth of {name}") for name in names]
    if isinstance(result, Result):
        limits = (max_translation_m, max_rotation_deg)
        place = None if benchmark is None else (os.fspath(benchmark), threshold_m)
        return _report(json.loads(result._run.evaluate(motions, folder, limits, place)), names)
    if motions is None or benchmark is not None or max_translation_m is None:
        expected = "a dictionary as truth, max_translation_m and no benchmark"
        raise input_error("result", "a dictionary of poses", expected, "pass those, or a Result")
    poses = [None if pose is None else matrix(pose, f"pose of {name}") for name, pose in result.items()]
    return _report(json.loads(evaluate_poses(poses, motions, (max_translation_m, max_rotation_deg))), names)


def _report(document: dict[str, Any], names: list[str]) -> Evaluation:
    errors, placement = document["errors"], document["placement"]
    summary = errors["pair_summary"]
    return Evaluation(
        recall=document["recall"],
        judged_pairs=placement["judged_pairs"],
        right_pairs=placement["right_pairs"],
        wrong_pairs=placement["wrong_pairs"],
        placed=errors["placed"],
        total=errors["total"],
        wrongly_placed=[names[wrong["scan"]] for wrong in placement["wrongly_placed"]],
        median_rotation_deg=summary["median_rotation_deg"],
        max_rotation_deg=summary["max_rotation_deg"],
        median_translation_m=summary["median_translation_m"],
        max_translation_m=summary["max_translation_m"],
        registration_recall=document["registration_recall"],
    )
