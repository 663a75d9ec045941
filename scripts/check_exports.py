"""Compares exported poses and pose graphs with poses.json, read by numpy, Open3D and plyfile.

Called by check-exports.sh. Nothing here uses code of this project: rotations are made from
quaternions by their formula, and pose graphs are optimised by Open3D.
"""

import argparse
import csv
import json
import math
import sys
from pathlib import Path

try:
    import numpy as np
except ImportError as error:
    sys.exit(f"skipped: everything, as there is no numpy ({error})")


def module(name):
    """A module, or None with a line that says why not."""
    try:
        return __import__(name)
    except Exception as error:  # a shared library may be missing, too
        print(f"skipped: what {name} reads ({str(error).splitlines()[0]})")
        return None


def matrix(t, q_xyzw):
    x, y, z, w = np.array(q_xyzw) / np.linalg.norm(q_xyzw)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = t
    return pose


def close(found, expected, tolerance, what):
    assert np.abs(found - expected).max() < tolerance, f"{what}:\n{found}\nexpected\n{expected}"


def numbers(path):
    return np.loadtxt(path, ndmin=2)


def name_of(stem, component, extension):
    return f"{stem}.{extension}" if component == 0 else f"{stem}_{component}.{extension}"


class Component:
    """The scans of one component as poses.json has them."""

    def __init__(self, document, number):
        self.number = number
        self.scans = [s for s in document["scans"] if s.get("component") == number]
        self.poses = [np.array(s["world_from_scan"]) for s in self.scans]
        self.pivot = document["components"][number]["pivot"]


def check_trajectories(folder, component):
    poses, scans = component.poses, component.scans

    rows = numbers(folder / name_of("trajectory", component.number, "tum"))
    assert len(rows) == len(poses)
    for row, pose in zip(rows, poses):
        close(matrix(row[1:4], row[4:]), pose, 1e-9, "tum")

    file = folder / name_of("trajectory_kitti", component.number, "txt")
    for row, pose in zip(numbers(file), poses, strict=True):
        close(row.reshape(3, 4), pose[:3], 1e-9, "kitti")
    names = file.with_name(file.stem + "_names.txt").read_text().splitlines()
    assert names == [s["name"] for s in scans], names

    with open(folder / name_of("trajectory", component.number, "csv"), newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [r["name"] for r in table] == [s["name"] for s in scans]
    for row, scan, pose in zip(table, scans, poses, strict=True):
        value = lambda *keys: [float(row[k]) for k in keys]
        close(matrix(value("tx", "ty", "tz"), value("qx", "qy", "qz", "qw")), pose, 1e-9, "csv")
        assert row["file"] == scan["file"] and int(row["component"]) == component.number
        probability = (scan["evidence"] or {}).get("probability")
        assert row["probability"] == "" if probability is None else abs(float(row["probability"]) - probability) < 1e-12
        covariance = (scan["pose_uncertainty"] or {}).get("covariance")
        if covariance is None:
            assert row["sigma_t_m"] == row["sigma_r_deg"] == ""
        else:
            # A symmetric matrix reads the same by rows and by columns.
            both = np.array(covariance).reshape(6, 6)
            largest = lambda block: math.sqrt(max(np.linalg.eigvalsh(block).max(), 0.0))
            assert abs(float(row["sigma_t_m"]) - largest(both[3:, 3:])) < 1e-9
            assert abs(float(row["sigma_r_deg"]) - math.degrees(largest(both[:3, :3]))) < 1e-9

    lines = (folder / name_of("images", component.number, "txt")).read_text().splitlines()
    lines = [l for l in lines if not l.startswith("#")]
    assert len(lines) == 2 * len(scans) and not any(lines[1::2])
    for line, scan, pose in zip(lines[::2], scans, poses, strict=True):
        words = line.split()
        qw, qx, qy, qz, tx, ty, tz = map(float, words[1:8])
        camera_from_world = matrix([tx, ty, tz], [qx, qy, qz, qw])
        close(np.linalg.inv(camera_from_world), pose, 1e-9, "colmap")
        assert words[9] == scan["name"] and int(words[0]) == scan["id"] + 1


def check_g2o(folder, component):
    """Vertices, and edges as (target, source, target_from_source, information over [t; q])."""
    vertices, edges, fixed = {}, [], []
    for line in (folder / name_of("pose_graph", component.number, "g2o")).read_text().splitlines():
        kind, *rest = line.split()
        values = [float(v) for v in rest]
        if kind == "VERTEX_SE3:QUAT":
            vertices[int(rest[0])] = matrix(values[1:4], values[4:8])
        elif kind == "FIX":
            fixed.append(int(rest[0]))
        else:
            assert kind == "EDGE_SE3:QUAT" and len(values) == 2 + 7 + 21
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = values[9:]
            information += np.triu(information, 1).T
            edges.append((int(rest[0]), int(rest[1]), matrix(values[2:5], values[5:9]), information))
    assert list(vertices) == [s["id"] for s in component.scans]
    for pose, expected in zip(vertices.values(), component.poses):
        close(pose, expected, 1e-9, "g2o")
    assert fixed == [component.pivot]
    for i, j, measured, information in edges:
        assert i in vertices and j in vertices and i != j
        eigenvalues = np.linalg.eigvalsh(information)
        assert eigenvalues.min() > 0, eigenvalues
    return edges


def check_open3d(open3d, folder, component, g2o_edges):
    graph = open3d.io.read_pose_graph(str(folder / name_of("pose_graph", component.number, "json")))
    assert len(graph.nodes) == len(component.poses) and len(graph.edges) == len(g2o_edges) > 0
    for node, pose in zip(graph.nodes, component.poses):
        close(node.pose, pose, 1e-9, "open3d")
    ids = [s["id"] for s in component.scans]
    # Rotation vector first, and twice the quaternion's vector.
    turn = np.zeros((6, 6))
    turn[:3, 3:], turn[3:, :3] = 2 * np.eye(3), np.eye(3)
    uncertain = 0
    for edge, (i, j, measured, information) in zip(graph.edges, g2o_edges):
        assert (ids[edge.target_node_id], ids[edge.source_node_id]) == (i, j)
        close(edge.transformation, measured, 1e-9, "edge")
        scale = np.abs(information).max()
        close((turn.T @ edge.information @ turn) / scale, information / scale, 1e-9, "information")
        uncertain += edge.uncertain
    registered_pairs = uncertain == len(g2o_edges)
    near = 0
    for edge in graph.edges:
        # Near the relative pose of the result, in this direction only.
        result = np.linalg.inv(component.poses[edge.target_node_id]) @ component.poses[edge.source_node_id]
        off = np.abs(edge.transformation - result).max()
        near += off < 0.2
        assert registered_pairs or off < (1e-6 if edge.uncertain else 0.2), f"an edge is off by {off}"
    # Pairs of a global method may be wrong, but those that agree with it must do so in this direction.
    assert near > len(g2o_edges) / 2, f"{near} of {len(g2o_edges)} edges agree with the poses"
    if not registered_pairs:
        check_optimum(open3d, graph, component, ids.index(component.pivot))
    return uncertain


def check_optimum(open3d, graph, component, pivot):
    """Optimised by Open3D, good poses stay where they are to within a few centimetres."""
    registration = open3d.pipelines.registration
    option = registration.GlobalOptimizationOption(
        max_correspondence_distance=0.05, reference_node=pivot
    )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        option,
    )
    for node, pose in zip(graph.nodes, component.poses):
        close(node.pose, pose, 0.2, "optimised by open3d")


def check_merged(plyfile, folder, component):
    data = plyfile.PlyData.read(folder / name_of("merged", component.number, "ply"))["vertex"]
    scans = set(np.unique(data["scan"]).tolist())
    assert len(data) > 0 and scans <= {s["id"] for s in component.scans}, scans


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--poses", type=Path, required=True)
    arguments = parser.parse_args()
    document = json.loads(arguments.poses.read_text())
    open3d, plyfile = module("open3d"), module("plyfile")
    for folder in arguments.folders:
        for number in range(len(document["components"])):
            component = Component(document, number)
            check_trajectories(folder, component)
            edges = check_g2o(folder, component)
            read = ["tum", "kitti", "csv", "colmap", "g2o"]
            if open3d:
                uncertain = check_open3d(open3d, folder, component, edges)
                read.append(f"open3d ({len(edges)} edges, {uncertain} uncertain)")
            if plyfile and (folder / name_of("merged", number, "ply")).exists():
                check_merged(plyfile, folder, component)
                read.append("merged.ply")
            print(f"{folder.name}, component {number}: {len(component.scans)} scans; {', '.join(read)}")


main()
