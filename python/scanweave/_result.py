"""The result of a registration."""

from __future__ import annotations

import html
import importlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._outcomes import Outcome, outcome_of
from ._scanweave import Run


@dataclass(frozen=True)
class Cloud:
    """A merged cloud.

    Attributes
    ----------
    points : ndarray of shape (n, 3)
        Metres, in the frame of the component.
    colors : ndarray of shape (n, 3), uint8, or None
        sRGB, where any of the scans has colour.
    scan : ndarray of shape (n,), uint32
        Index of the scan that gave a point most of its measurements.
    """

    points: NDArray[np.float64]
    colors: Optional[NDArray[np.uint8]]
    scan: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.points)

    def to_open3d(self) -> Any:
        """As an ``open3d.geometry.PointCloud``; needs Open3D."""
        return _open3d_cloud(self.points, self.colors)


@dataclass(frozen=True)
class PoseEdge:
    """Two scans of a pose graph.

    Attributes
    ----------
    target, source : str
        The scans.
    target_from_source : ndarray of shape (4, 4)
        Takes coordinates of the source (metres) to those of the target, as measured.
    information : ndarray of shape (6, 6)
        Inverse covariance of the error: of a rotation vector (radians), then of a translation (metres), in
        the frame of the source about its zero.
    uncertain : bool
        Whether a solver may drop the edge.
    """

    target: str
    source: str
    target_from_source: NDArray[np.float64]
    information: NDArray[np.float64]
    uncertain: bool


@dataclass(frozen=True)
class PoseGraph:
    """A component as a graph of scans and relative poses.

    Attributes
    ----------
    nodes : dict of str to ndarray of shape (4, 4)
        ``world_from_scan`` of every scan of the component.
    edges : list of PoseEdge
        What was measured between them.
    """

    nodes: dict[str, NDArray[np.float64]]
    edges: list[PoseEdge]

    def to_open3d(self) -> Any:
        """As an ``open3d.pipelines.registration.PoseGraph``, nodes in the same order; needs Open3D."""
        registration = _open3d().pipelines.registration
        graph = registration.PoseGraph()
        index = {name: i for i, name in enumerate(self.nodes)}
        for pose in self.nodes.values():
            graph.nodes.append(registration.PoseGraphNode(pose))
        for edge in self.edges:
            # Open3D's edge takes coordinates of its source to those of its target.
            graph.edges.append(
                registration.PoseGraphEdge(
                    index[edge.source],
                    index[edge.target],
                    edge.target_from_source,
                    edge.information,
                    edge.uncertain,
                )
            )
        return graph


class Result:
    """Where every scan is, and why.

    Poses are ``world_from_scan``: they take coordinates of a scan, in metres, to those of its component.
    Poses of different components are unrelated.

    Attributes
    ----------
    outcomes : dict of str to Outcome
        One a scan, by name, in the order of the scans.
    remarks : list of str
        What was odd about the scans. Those that may matter were warned of.
    """

    def __init__(self, run: Run, remarks: list[str]) -> None:
        self._run = run
        self._document: dict[str, Any] = json.loads(run.poses_json())
        entries = self._document["scans"]
        self.names: list[str] = [entry["name"] for entry in entries]
        self.outcomes: dict[str, Outcome] = {
            entry["name"]: outcome_of(entry, self.names) for entry in entries
        }
        self.remarks = remarks

    @property
    def poses(self) -> dict[str, Optional[NDArray[np.float64]]]:
        """``world_from_scan`` of shape (4, 4) by the name of the scan; ``None`` where it was declined."""
        return {name: outcome.pose for name, outcome in self.outcomes.items()}

    @property
    def components(self) -> list[list[str]]:
        """Names of the scans of every component, the largest first."""
        return [[self.names[scan] for scan in c["scans"]] for c in self._document["components"]]

    @property
    def declined(self) -> dict[str, str]:
        """Why scans have no pose, by name."""
        return {name: o.reason for name, o in self.outcomes.items() if o.reason is not None}

    @property
    def predicted_overlap(self) -> NDArray[np.float32]:
        """Predicted overlap of every two scans, of shape (N, N), in the order of :attr:`names`."""
        return self._run.predicted_overlap

    @property
    def voxel_m(self) -> float:
        """Working voxel, metres."""
        return self._run.lengths_m[0]

    @property
    def inlier_radius_m(self) -> float:
        """Inlier radius: matches and points within it agree, metres."""
        return self._run.lengths_m[1]

    @property
    def timings(self) -> dict[str, float]:
        """Seconds of every stage."""
        return dict(self._run.timings)

    @property
    def config(self) -> str:
        """The settings that were in effect, as a TOML file."""
        return self._run.config_toml()

    @property
    def pose_graph(self) -> PoseGraph:
        """The largest component as a pose graph."""
        return self.pose_graph_of(0)

    def pose_graph_of(self, component: int) -> PoseGraph:
        """A component as a pose graph.

        Parameters
        ----------
        component : int
            Index into :attr:`components`.
        """
        scans, edges = self._run.pose_graph(component)
        names = [self.names[scan] for scan in scans]
        poses = self.poses
        nodes = {name: pose for name in names if (pose := poses[name]) is not None}
        return PoseGraph(nodes, [PoseEdge(names[i], names[j], *rest) for i, j, rest in edges])

    def merged(self, voxel: Optional[float] = None, component: int = 0) -> Cloud:
        """All placed scans of a component in one cloud, one point a voxel.

        Parameters
        ----------
        voxel : float, optional
            Edge of a voxel, metres. Default: that of ``merged.ply``, half of the working voxel.
        component : int
            Index into :attr:`components`.
        """
        return Cloud(*self._run.merged(component, voxel))

    def to_open3d(self, component: Optional[int] = None) -> dict[str, Any]:
        """Placed scans, whole, as ``open3d.geometry.PointCloud`` in the frame of their component.

        Parameters
        ----------
        component : int, optional
            Index into :attr:`components`. Default: scans of all components.

        Returns
        -------
        dict of str to open3d.geometry.PointCloud
            By the name of the scan. Needs Open3D.
        """
        clouds: dict[str, Any] = {}
        for scan, (name, outcome) in enumerate(self.outcomes.items()):
            if outcome.placed and component in (None, outcome.component):
                placed = self._run.placed_points(scan)
                if placed is not None:
                    clouds[name] = _open3d_cloud(*placed)
        return clouds

    def save(
        self,
        directory: Union[str, os.PathLike[str]],
        force: bool = False,
        trajectory: Sequence[str] = (),
        pose_graph: Sequence[str] = (),
    ) -> Path:
        """Write the folder that ``scanweave register`` writes: poses.json, merged.ply, report.html, and so on.

        Parameters
        ----------
        directory : path
            Made where it does not exist.
        force : bool
            Replace the result that it already holds.
        trajectory : sequence of str
            Also write the poses as ``"tum"``, ``"kitti"``, ``"csv"``, ``"colmap"``.
        pose_graph : sequence of str
            Also write pose graphs as ``"g2o"``, ``"open3d"``.

        Returns
        -------
        pathlib.Path
            The folder.
        """
        self._run.save(os.fspath(directory), force, list(trajectory), list(pose_graph))
        return Path(directory)

    def to_html(self) -> str:
        """The 3D report, one page for any browser, without a network."""
        return self._run.html()

    def _repr_html_(self) -> str:
        """The 3D report in a notebook."""
        page = html.escape(self.to_html(), quote=True)
        style = "width:100%;height:900px;box-sizing:border-box;border:1px solid #ccc"
        return (
            f'<iframe srcdoc="{page}" style="{style}" sandbox="allow-scripts allow-downloads" '
            f'title="scanweave: {html.escape(repr(self), quote=True)}"></iframe>'
        )

    def __repr__(self) -> str:
        placed = sum(outcome.placed for outcome in self.outcomes.values())
        return f"Result({placed} of {len(self.names)} scans placed, components: {len(self.components)})"


def _open3d() -> Any:
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise ImportError("to_open3d() needs Open3D: pip install open3d") from error


def _open3d_cloud(points: NDArray[np.float64], colors: Optional[NDArray[np.uint8]]) -> Any:
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector(points)
    if colors is not None:
        cloud.colors = o3d.utility.Vector3dVector(colors / 255.0)
    return cloud
