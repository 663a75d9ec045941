#!/usr/bin/env python3
"""Writes tests/fixtures/fpfh_open3d.json: FPFH of a small cloud by Open3D.

    pip install open3d numpy
    python scripts/fpfh_reference.py > tests/fixtures/fpfh_open3d.json

The cloud is a seeded sample of a wavy sheet with its analytic normals. All numbers are
rounded to single precision before Open3D sees them, so that both sides work on the same.
"""

import json

import numpy as np
import open3d as o3d

COUNT = 60
RADIUS = 0.45

rng = np.random.default_rng(20240601)
xy = rng.uniform(0.0, 1.0, (COUNT, 2))
z = 0.2 * np.sin(5.0 * xy[:, 0]) * np.cos(4.0 * xy[:, 1])
points = np.column_stack([xy, z]).astype(np.float32).astype(np.float64)
slope_x = 1.0 * np.cos(5.0 * xy[:, 0]) * np.cos(4.0 * xy[:, 1])
slope_y = -0.8 * np.sin(5.0 * xy[:, 0]) * np.sin(4.0 * xy[:, 1])
normals = np.column_stack([-slope_x, -slope_y, np.ones(COUNT)])
normals /= np.linalg.norm(normals, axis=1, keepdims=True)
normals = normals.astype(np.float32).astype(np.float64)

cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
cloud.normals = o3d.utility.Vector3dVector(normals)
fpfh = o3d.pipelines.registration.compute_fpfh_feature(
    cloud, o3d.geometry.KDTreeSearchParamRadius(RADIUS)
).data.T

rows = lambda a, digits: [[float(f"{v:.{digits}g}") for v in row] for row in a]
print(
    json.dumps(
        {
            "open3d": o3d.__version__,
            "radius": RADIUS,
            "points": rows(points, 9),
            "normals": rows(normals, 9),
            "fpfh": rows(fpfh, 7),
        }
    ).replace("], [", "],\n[")
)
