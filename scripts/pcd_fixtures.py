#!/usr/bin/env python3
"""Writes tests/fixtures/pcd/: PCD files by an independent writer (pypcd4, `pip install pypcd4`).

Every file has the fields tag (one byte), x (float), y (double), z (float), rgb (packed colour).
"""
import pathlib

import numpy as np
from pypcd4 import Encoding, PointCloud

FIELDS = ("tag", "x", "y", "z", "rgb")
TYPES = (np.uint8, np.float32, np.float64, np.float32, np.uint32)
ROWS = {
    "grid": np.array([[i * 0.1, -2.0, i % 7] for i in range(200)]),
    "same": np.array([[1.0, 2.0, 3.0]] * 50),
    "line": np.array([[i, 2.0, 3.0] for i in range(20)], dtype=float),
}

folder = pathlib.Path(__file__).parent.parent / "tests/fixtures/pcd"
for name, rows in ROWS.items():
    n = len(rows)
    rgb = 0xFF000000 | np.arange(n, dtype=np.uint32) << 16 | 0x1020
    columns = [np.full(n, 1, np.uint8), rows[:, 0].astype(np.float32), rows[:, 1], rows[:, 2].astype(np.float32), rgb]
    cloud = PointCloud.from_points(columns, FIELDS, TYPES)
    for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED):
        cloud.save(folder / f"{name}_{encoding.value}.pcd", encoding=encoding)
