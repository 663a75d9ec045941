"""What the functions beside ``register`` return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from ._outcomes import Evidence
from ._scanweave import Scan


@dataclass(frozen=True)
class RegisteredPair:
    """What became of a pair of scans.

    Attributes
    ----------
    target_from_source : ndarray of shape (4, 4) or None
        Takes coordinates of the source (metres) to those of the target; ``None`` where nothing was found.
    accepted : bool
        Whether the evidence suffices by the settings: without it the motion is a guess.
    evidence : Evidence
        What speaks for the motion.
    probability : float or None
        That of the evidence.
    reason : str or None
        Why it is not accepted.
    """

    target_from_source: Optional[NDArray[np.float64]]
    accepted: bool
    evidence: Evidence
    probability: Optional[float]
    reason: Optional[str]


@dataclass(frozen=True)
class Features:
    """Keypoints and descriptors of a scan.

    Attributes
    ----------
    keypoints : ndarray of shape (n, 3)
        Metres, in the frame of the scan.
    descriptors : ndarray of shape (n, D), float32
        One row a keypoint.
    """

    keypoints: NDArray[np.float64]
    descriptors: NDArray[np.float32]


@dataclass(frozen=True)
class Overlap:
    """Predicted overlap.

    Attributes
    ----------
    names : list of str
        The scans.
    values : ndarray of shape (N, N), float32
        Symmetric; larger where two scans are more alike.
    """

    names: list[str]
    values: NDArray[np.float32]

    def __getitem__(self, pair: tuple[str, str]) -> float:
        """That of two scans, by their names."""
        a, b = pair
        return float(self.values[self.names.index(a), self.names.index(b)])


@dataclass(frozen=True)
class SyntheticScans:
    """Scans of a synthetic interior, with the truth.

    Attributes
    ----------
    scans : list of Scan
        In random order, each in the frame of the sensor.
    truth : dict of str to ndarray of shape (4, 4)
        True ``world_from_scan`` of every scan, in the frame of its building.
    unrelated : list of str
        Scans of other buildings.
    """

    scans: list[Scan]
    truth: dict[str, NDArray[np.float64]]
    unrelated: list[str]
