"""What a result writes and shows, and that it is what the command writes."""

from __future__ import annotations

import filecmp
import html
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import command

import scanweave

#: Everything that does not state times.
SAME = ["poses.json", "merged.ply", "trajectory.log", "overlap.csv", "config.toml"]


@pytest.fixture(scope="module")
def folders(room_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Written by the command and by the package."""
    place = tmp_path_factory.mktemp("written")
    by_command, by_package = place / "command", place / "package"
    done = command("register", room_folder, "-o", by_command, "--seed", 3, "--set", "descriptor.keypoints.count=1500")
    assert done.returncode == 0, done.stderr
    settings = {"descriptor": {"keypoints": {"count": 1500}}}
    scanweave.register(room_folder, config=settings, seed=3).save(by_package)
    return by_command, by_package


def test_the_same_bytes_as_the_command(folders: tuple[Path, Path]) -> None:
    by_command, by_package = folders
    for name in SAME:
        assert filecmp.cmp(by_command / name, by_package / name, shallow=False), name
    written = {path.name for path in by_command.iterdir() if path.is_file()}
    assert {path.name for path in by_package.iterdir() if path.is_file()} == written


def test_the_same_bytes_as_the_cargo_built_command(room_folder: Path, folders: tuple[Path, Path], tmp_path: Path) -> None:
    binary = os.environ.get("SCANWEAVE_BINARY")
    if not binary:
        pytest.skip("SCANWEAVE_BINARY does not name a binary built by cargo")
    import subprocess

    options = ["--seed", "3", "--set", "descriptor.keypoints.count=1500"]
    subprocess.run([binary, "register", str(room_folder), "-o", str(tmp_path / "r"), *options], check=True)
    for name in SAME:
        assert filecmp.cmp(tmp_path / "r" / name, folders[1] / name, shallow=False), name


def test_a_saved_folder_is_one_that_the_command_takes(folders: tuple[Path, Path], tmp_path: Path, room_folder: Path) -> None:
    result = shutil.copytree(folders[1], tmp_path / "result")
    assert command("export", result, "--trajectory", "tum").returncode == 0
    done = command("evaluate", result, "--truth", room_folder / "PointCloud", "--json")
    assert done.returncode == 0 and json.loads(done.stdout)["poses"]["placed"] >= 5


def test_saving_refuses_what_is_there_and_writes_formats(result: scanweave.Result, tmp_path: Path) -> None:
    place = result.save(tmp_path / "r", trajectory=["tum"], pose_graph=["open3d"])
    assert (place / "trajectory.tum").exists() and (place / "pose_graph.json").exists()
    with pytest.raises(scanweave.OutputError, match="already holds a result.*force=True"):
        result.save(place)
    assert result.save(str(place), force=True) == place
    with pytest.raises(scanweave.InputError, match="trajectory: found `las`, expected one of tum"):
        result.save(tmp_path / "other", trajectory=["las"])


def test_merged_cloud(result: scanweave.Result, folders: tuple[Path, Path]) -> None:
    usual, coarse = result.merged(), result.merged(voxel=0.2)
    assert len(usual) > len(coarse) > 100 and usual.points.shape == (len(usual), 3)
    assert coarse.colors is not None and coarse.colors.dtype == np.uint8
    assert {result.names[i] for i in np.unique(usual.scan)} == set(result.components[0])
    with pytest.raises(scanweave.InputError, match="voxel: found -1"):
        result.merged(voxel=-1)
    with pytest.raises(scanweave.InputError, match="component: found 9"):
        result.merged(component=9)


def test_pose_graph(result: scanweave.Result) -> None:
    graph = result.pose_graph
    assert list(graph.nodes) == result.components[0] and len(graph.edges) >= len(graph.nodes) - 1
    for edge in graph.edges:
        final = np.linalg.inv(graph.nodes[edge.target]) @ graph.nodes[edge.source]
        assert np.abs(final - edge.target_from_source).max() < 0.1
        assert np.linalg.eigvalsh(edge.information).min() > 0


def test_the_page_is_a_frame_that_holds_the_report(result: scanweave.Result) -> None:
    shown = result._repr_html_()
    found = re.fullmatch(r'<iframe srcdoc="([^"]*)"[^>]*sandbox="allow-scripts allow-downloads"[^>]*></iframe>', shown)
    assert found, shown[:200]
    page = html.unescape(found[1])
    assert page == result.to_html() and page.lstrip().lower().startswith("<!doctype html>")
    for name in result.names:
        assert name in page


def test_open3d_by_a_stand_in(result: scanweave.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    open3d = StandIn()
    monkeypatch.setattr("scanweave._result._open3d", lambda: open3d)
    clouds = result.to_open3d(component=0)
    assert list(clouds) == result.components[0]
    name = result.components[0][1]
    pose, scan = result.poses[name], clouds[name]
    assert pose is not None and len(scan.points) > 1000 and 0 <= scan.colors.min() <= scan.colors.max() <= 1
    graph = result.pose_graph.to_open3d()
    assert len(graph.nodes) == len(result.components[0])
    first = result.pose_graph.edges[0]
    assert result.components[0][graph.edges[0][0]] == first.source
    assert result.components[0][graph.edges[0][1]] == first.target


def test_open3d_itself(result: scanweave.Result, scans: list[scanweave.Scan]) -> None:
    o3d: Any = pytest.importorskip("open3d", exc_type=ImportError)
    graph = result.pose_graph.to_open3d()
    # Open3D's own optimisation agrees that the poses fit the edges: they hardly move.
    before = [node.pose.copy() for node in graph.nodes]
    registration = o3d.pipelines.registration
    option = registration.GlobalOptimizationOption(max_correspondence_distance=result.inlier_radius_m, reference_node=0)
    o3d.pipelines.registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        option,
    )
    for old, node in zip(before, graph.nodes):
        assert np.abs(old - node.pose).max() < 0.05
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points)) for scan in scans[:2]]
    tensors = [o3d.t.geometry.PointCloud.from_legacy(cloud) for cloud in clouds]
    read = [scanweave.describe(held, config={"descriptor.kind": "fpfh"}) for held in (clouds, tensors)]
    assert all(np.array_equal(read[0][n].keypoints, read[1][n].keypoints) for n in ("scan_0", "scan_1"))
    cloud = result.merged().to_open3d()
    assert len(cloud.points) == len(result.merged()) and cloud.has_colors()


class StandIn:
    """As much of Open3D as results are turned into."""

    def __init__(self) -> None:
        self.geometry = self.utility = self.pipelines = self.registration = self

    class PointCloud:
        points: Any = None
        colors: Any = None

    class PoseGraph:
        def __init__(self) -> None:
            self.nodes: list[Any] = []
            self.edges: list[Any] = []

    @staticmethod
    def Vector3dVector(values: Any) -> Any:
        return np.asarray(values, dtype=np.float64)

    @staticmethod
    def PoseGraphNode(pose: Any) -> Any:
        return pose

    @staticmethod
    def PoseGraphEdge(source: int, target: int, motion: Any, information: Any, uncertain: bool) -> Any:
        return source, target, motion, information, uncertain
