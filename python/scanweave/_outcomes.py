"""What became of every scan, from the document that the native part gives (docs/poses-json.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Evidence:
    """What speaks for a pose.

    Attributes
    ----------
    matches, inliers : int
        Mutual matches of descriptors, and those within the inlier radius under the pose.
    second_best_inliers : int
        Inliers of the next distinct hypothesis.
    chance_inliers : float
        Inliers that there would be if matches were paired at random.
    overlap : float
        Share of the surface within the inlier radius of the model, 0 to 1.
    normal_agreement : float
        Share of that whose normals agree, 0 to 1.
    plane_residual : float
        Root mean square distance to tangent planes, in inlier radii.
    free_space_violation : float
        Share of points in space that the other scan saw to be empty, 0 to 1.
    localizability : float
        Least eigenvalue of the normalised information about the pose: 0 where some motion is free.
    probability : float or None
        Probability that the pose is right; ``None`` where it was not measured.
    parent_from_scan : ndarray of shape (4, 4) or None
        The pose relative to the parent when the scan joined.
    """

    matches: int
    inliers: int
    second_best_inliers: int
    chance_inliers: float
    overlap: float
    normal_agreement: float
    plane_residual: float
    free_space_violation: float
    localizability: float
    probability: Optional[float]
    parent_from_scan: Optional[NDArray[np.float64]]


@dataclass(frozen=True)
class Neighbour:
    """Agreement with another placed scan at the final poses.

    Attributes
    ----------
    name : str
        The other scan.
    overlap : float
        Two-way share of keypoints with a counterpart within the inlier radius, 0 to 1.
    residual_m : float
        Root mean square distance of those keypoints, metres.
    plane_distance_m : float or None
        Median distance of the surfaces from each other's tangent planes, metres.
    """

    name: str
    overlap: float
    residual_m: float
    plane_distance_m: Optional[float]


@dataclass(frozen=True)
class Outcome:
    """The outcome on one scan: placed with evidence, or declined with a reason.

    Attributes
    ----------
    name : str
        The scan.
    placed : bool
        Whether it has a pose.
    pose : ndarray of shape (4, 4) or None
        ``world_from_scan``: takes coordinates of the scan (metres) to those of its component.
    component : int or None
        Index into :attr:`Result.components`.
    evidence : Evidence or None
        ``None`` for a pivot that nothing was compared with.
    probability : float or None
        That of the evidence.
    covariance : ndarray of shape (6, 6) or None
        Of the pose relative to the pivot: a rotation vector (radians), then the displacement of the
        scan's centre (metres), both in the axes of the component.
    centre : ndarray of shape (3,) or None
        The centre that the covariance refers to, in coordinates of the scan, metres.
    parent : str or None
        The placed scan that it shares most inliers with; ``None`` for a pivot.
    residual_m : float or None
        Root mean square distance of its inliers, metres.
    neighbours : tuple of Neighbour
        Every placed scan that it touches.
    doubts : tuple of str
        ``"ambiguous"``, ``"poorly-localised"``.
    reason : str or None
        Why it was declined, for people.
    reason_code : str or None
        Why, for programs: ``"too-few-inliers"``, ``"weak-evidence"``, and so on.
    """

    name: str
    placed: bool
    pose: Optional[NDArray[np.float64]]
    component: Optional[int]
    evidence: Optional[Evidence]
    probability: Optional[float]
    covariance: Optional[NDArray[np.float64]]
    centre: Optional[NDArray[np.float64]]
    parent: Optional[str]
    residual_m: Optional[float]
    neighbours: tuple[Neighbour, ...]
    doubts: tuple[str, ...]
    reason: Optional[str]
    reason_code: Optional[str]


def evidence_of(entry: dict[str, Any]) -> Evidence:
    """Evidence from its document."""
    return Evidence(
        matches=entry["matches"],
        inliers=entry["inliers"],
        second_best_inliers=entry["second_best_inliers"],
        chance_inliers=entry["chance_inliers"],
        overlap=entry["overlap"],
        normal_agreement=entry["normal_agreement"],
        plane_residual=entry["plane_residual"],
        free_space_violation=entry["free_space_violation"],
        localizability=entry["localizability"],
        probability=entry["probability"],
        parent_from_scan=_motion(entry.get("parent_from_scan")),
    )


def outcome_of(entry: dict[str, Any], names: list[str]) -> Outcome:
    """The outcome of an entry of ``scans``."""
    if entry["outcome"] == "declined":
        reason, code = entry["explanation"], entry["decline"]["reason"]
        nothing = (None, None, None, None, None, None, None, None)
        return Outcome(entry["name"], False, *nothing, (), (), reason, code)
    evidence = None if entry["evidence"] is None else evidence_of(entry["evidence"])
    uncertainty = entry.get("pose_uncertainty") or {}
    covariance, centre = uncertainty.get("covariance"), uncertainty.get("centre")
    return Outcome(
        name=entry["name"],
        placed=True,
        pose=np.array(entry["world_from_scan"], dtype=np.float64),
        component=entry["component"],
        evidence=evidence,
        probability=None if evidence is None else evidence.probability,
        covariance=None if covariance is None else np.array(covariance, dtype=np.float64).reshape(6, 6),
        centre=None if centre is None else np.array(centre, dtype=np.float64),
        parent=None if entry["parent"] is None else names[entry["parent"]],
        residual_m=entry["residual_m"],
        neighbours=tuple(
            Neighbour(names[n["scan"]], n["overlap"], n["residual_m"], n.get("plane_distance_m"))
            for n in entry["neighbours"]
        ),
        doubts=tuple(entry["doubts"]),
        reason=None,
        reason_code=None,
    )


def _motion(entry: Optional[dict[str, Any]]) -> Optional[NDArray[np.float64]]:
    """A rotation (quaternion x, y, z, w) and a translation as a matrix."""
    if entry is None:
        return None
    x, y, z, w = entry["rotation"]
    motion = np.eye(4)
    motion[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    motion[:3, 3] = entry["translation"]
    return motion
