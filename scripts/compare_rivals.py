#!/usr/bin/env python3
"""Scanweave, Open3D's multiway registration and KISS-Matcher on the same scans: recall, seconds, memory.

Usage: compare_rivals.py SCANWEAVE DATA OUT SCENE...

SCANWEAVE is the binary; DATA holds 3dmatch/<scene>/PointCloud and benchmarks/{3DMatch,3DLoMatch}/<scene>;
results go to OUT/<method>/<scene>, and a table to standard output. In an environment of its own:

    python3 -m venv rivals && rivals/bin/pip install open3d kiss-matcher numpy
    rivals/bin/python scripts/compare_rivals.py target/release/scanweave DATA OUT SCENE...

(Open3D needs the system libraries libusb-1.0-0 and libgl1.) Every method runs in a process of its own on
all processors. Open3D and KISS-Matcher register all pairs, at a voxel of 5 cm: Open3D by FPFH and RANSAC
of 100000 rounds, as in its tutorial; KISS-Matcher with its defaults. A pair is kept when its information
matrix implies an overlap of at least 0.3 of the smaller scan, as in Open3D's reconstruction system. Poses are
initialised from the maximum spanning tree by overlap. The pose graph of all kept pairs is then optimised with
Open3D's line process. Scanweave runs without a flag. `scanweave evaluate` evaluates all three.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

VOXEL_M = 0.05
LEAST_OVERLAP = 0.3


def pairwise_by_open3d(clouds):
    import open3d as o3d

    reg = o3d.pipelines.registration
    feature = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * VOXEL_M, max_nn=100)
    features = [reg.compute_fpfh_feature(cloud, feature) for cloud in clouds]
    limit = 1.4 * VOXEL_M
    checks = [
        reg.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        reg.CorrespondenceCheckerBasedOnDistance(limit),
    ]

    def register(i, j):
        found = reg.registration_ransac_based_on_feature_matching(
            clouds[j],
            clouds[i],
            features[j],
            features[i],
            True,
            limit,
            reg.TransformationEstimationPointToPoint(False),
            3,
            checks,
            reg.RANSACConvergenceCriteria(100000, 0.999),
        )
        return found.transformation

    return register


def pairwise_by_kiss_matcher(clouds):
    import kiss_matcher
    import numpy as np

    points = [np.asarray(cloud.points, dtype=np.float32) for cloud in clouds]
    config = kiss_matcher.KISSMatcherConfig(VOXEL_M)

    def register(i, j):
        # A matcher of its own a pair: it keeps state between calls.
        found = kiss_matcher.KISSMatcher(config).estimate(points[j], points[i])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = found.rotation, np.asarray(found.translation).ravel()
        return pose

    return register


def register_all(method, scans, out):
    import numpy as np
    import open3d as o3d

    reg = o3d.pipelines.registration
    clouds = []
    for path in scans:
        cloud = o3d.io.read_point_cloud(str(path)).voxel_down_sample(VOXEL_M)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * VOXEL_M, max_nn=30))
        clouds.append(cloud)
    pairwise = {"open3d": pairwise_by_open3d, "kiss-matcher": pairwise_by_kiss_matcher}[method](clouds)
    n = len(clouds)
    edges = []
    for i in range(n):
        for j in range(i + 1, n):
            i_from_j = np.asarray(pairwise(i, j))
            if not np.isfinite(i_from_j).all() or np.trace(i_from_j) == 4.0:
                continue
            information = reg.get_information_matrix_from_point_clouds(
                clouds[j], clouds[i], 1.4 * VOXEL_M, i_from_j
            )
            overlap = information[5, 5] / min(len(clouds[i].points), len(clouds[j].points))
            if overlap >= LEAST_OVERLAP:
                edges.append((overlap, i, j, i_from_j, information))
    # The spanning tree of most overlap; the scans of the largest tree are placed.
    poses, group = [np.eye(4) for _ in range(n)], list(range(n))
    for _, i, j, i_from_j, _ in sorted(edges, key=lambda e: -e[0]):
        if group[i] != group[j]:
            moved, kept = group[j], group[i]
            shift = poses[i] @ i_from_j @ np.linalg.inv(poses[j])
            for k in range(n):
                if group[k] == moved:
                    poses[k], group[k] = shift @ poses[k], kept
    largest = max(set(group), key=group.count)
    placed = [k for k in range(n) if group[k] == largest]
    graph = reg.PoseGraph()
    for k in placed:
        graph.nodes.append(reg.PoseGraphNode(poses[k]))
    node = {k: at for at, k in enumerate(placed)}
    for _, i, j, i_from_j, information in edges:
        if i in node and j in node:
            graph.edges.append(reg.PoseGraphEdge(node[j], node[i], i_from_j, information, uncertain=True))
    reg.global_optimization(
        graph,
        reg.GlobalOptimizationLevenbergMarquardt(),
        reg.GlobalOptimizationConvergenceCriteria(),
        reg.GlobalOptimizationOption(
            max_correspondence_distance=1.4 * VOXEL_M,
            edge_prune_threshold=0.25,
            preference_loop_closure=1.0,
            reference_node=0,
        ),
    )
    lines = []
    for k, found in zip(placed, graph.nodes):
        number = int("".join(c for c in Path(scans[k]).stem if c.isdigit()))
        lines.append(f"{number}\t{number}\t{n}")
        lines += ["\t".join(f"{x:.9e}" for x in row) for row in found.pose]
    out.mkdir(parents=True, exist_ok=True)
    (out / "trajectory.log").write_text("\n".join(lines) + "\n")


def measured(command):
    """Seconds and peak memory (MiB) of a command with its children."""
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"{' '.join(command)}: failed")
    return time.monotonic() - start, usage.ru_maxrss / 1024


def main():
    if len(sys.argv) > 2 and sys.argv[1] == "--one":
        method, out, *scans = sys.argv[2:]
        register_all(method, scans, Path(out))
        return
    if len(sys.argv) < 5:
        sys.exit(__doc__)
    binary, data, out, *scenes = sys.argv[1:]
    data, out = Path(data), Path(out)
    print("| scene | method | placed | 3DMatch % | 3DLoMatch % | seconds | peak MiB |")
    print("|---|---|--:|--:|--:|--:|--:|")
    for scene in scenes:
        folder = data / "3dmatch" / scene / "PointCloud"
        scans = sorted(map(str, folder.glob("*.ply")), key=lambda p: (len(p), p))
        if not scans:
            sys.exit(f"{folder}: no scans (*.ply)")
        for method in ["scanweave", "open3d", "kiss-matcher"]:
            result = out / method / scene
            if method == "scanweave":
                command = [binary, "register", str(folder), "-o", str(result), "--force", "-q"]
            else:
                command = [sys.executable, __file__, "--one", method, str(result), *scans]
            seconds, memory = measured(command)
            evaluate = [binary, "evaluate", str(out / method), "--dataset", str(data / "3dmatch")]
            evaluate += ["--scene", scene, "--protocol", "3dmatch", "--protocol", "3dlomatch", "--json"]
            found = json.loads(subprocess.run(evaluate, check=True, capture_output=True).stdout)
            row = figures(found)
            print(f"| {scene} | {method} | {row} | {seconds:.1f} | {memory:.0f} |", flush=True)


def figures(found):
    """Placed scans and both recalls from what `evaluate --json` says of one scene."""
    (scene,) = found["scenes"]
    recalls = [scene["recalls"][name] for name in ["3dmatch", "3dlomatch"]]
    shares = [f"{100 * r['succeeded'] / r['counted']:.1f}" for r in recalls]
    return " | ".join([f"{scene['placed']} of {scene['scans']}", *shares])


if __name__ == "__main__":
    main()
