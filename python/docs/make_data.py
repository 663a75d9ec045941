"""Synthetic scans for the worked pages: ``python make_data.py turntable|terrestrial FOLDER``.

Writes one PLY a scan, in the frame of the sensor, and truth.json with world_from_scan of every file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def turntable(folder: Path, views: int = 12, seed: int = 0) -> None:
    """A bumpy object of about 15 cm that turns in steps of 30 degrees before a range camera."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(26, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centres = directions * np.array([0.05, 0.035, 0.06])
    radii = rng.uniform(0.008, 0.024, len(centres))
    centres, radii = np.vstack([centres, np.zeros((1, 3))]), np.append(radii, 0.035)

    def distance(points: Array) -> Array:
        """Signed distance of a smooth union of balls, metres."""
        each = np.linalg.norm(points[:, None] - centres, axis=2) - radii
        softness = 0.003
        return np.asarray(-softness * np.log(np.exp(-each / softness).sum(axis=1)))

    u, v = np.meshgrid(np.linspace(-0.16, 0.16, 180), np.linspace(-0.16, 0.16, 180))
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    truth = {}
    for view in range(views):
        angle = 2 * np.pi * view / views
        eye = 0.6 * np.array([np.cos(angle) * 0.94, np.sin(angle) * 0.94, 0.34])
        pose = look_at(eye, np.zeros(3))
        turned = rays @ pose[:3, :3].T
        # Only rays that pass within 9 cm of the middle, where the object ends.
        passes = np.linalg.norm(np.cross(turned, eye), axis=1) < 0.09
        depth, near = np.full(len(rays), np.inf), np.full(passes.sum(), 0.45)
        for _ in range(15):
            near += np.clip(distance(eye + near[:, None] * turned[passes]), -0.05, 0.05)
        depth[passes] = np.where(np.abs(distance(eye + near[:, None] * turned[passes])) < 2e-4, near, np.inf)
        hit = depth < 0.8
        noisy = depth[hit] + rng.normal(scale=2e-4, size=hit.sum())
        name = f"view_{view:02}.ply"
        write_ply(folder / name, noisy[:, None] * rays[hit])
        truth[name] = pose.tolist()
    (folder / "truth.json").write_text(json.dumps(truth))


def terrestrial(folder: Path, seed: int = 0) -> None:
    """A courtyard of 24 by 18 m, scanned from five stations that were levelled but not oriented."""
    rng = np.random.default_rng(seed)
    boxes: list[tuple[tuple[float, ...], tuple[float, ...]]]
    boxes = [((-12, -9, -0.2), (12, 9, 0)), ((-12.3, -9, 0), (-12, 9, 6)), ((12, -9, 0), (12.3, 9, 8))]
    boxes += [((-12, -9.3, 0), (12, -9, 5)), ((-12, 9, 0), (12, 9.3, 7)), ((3, 5.5, 0), (8, 9, 3.2))]
    for _ in range(26):
        low = np.array([rng.uniform(-11.5, 10), rng.uniform(-8.5, 7), 0.0])
        boxes.append((tuple(low), tuple(low + rng.uniform([0.3, 0.3, 0.4], [1.6, 1.6, 2.2]))))
    for _ in range(40):  # sills and niches of the walls
        wall = rng.integers(4)
        along, up = rng.uniform(-8.5, 8.5), rng.uniform(0.5, 4.5)
        size = rng.uniform([0.4, 0.3, 0.1], [1.8, 1.5, 0.5])
        at = (np.array([-12.0, along, up]), np.array([12 - size[2], along, up]))
        across = (np.array([along, -9.0, up]), np.array([along, 9 - size[2], up]))
        low = (*at, *across)[wall]
        extent = np.array([size[2], size[0], size[1]] if wall < 2 else [size[0], size[2], size[1]])
        boxes.append((tuple(low), tuple(low + extent)))
    lows, highs = (np.array([box[side] for box in boxes], dtype=float) for side in (0, 1))
    trees = np.array([[-6.0, 3.5, 0.25], [1.5, -4.0, 0.18], [7.5, 1.0, 0.3]])  # x, y, radius
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 480, False), np.linspace(-0.9, 0.9, 140))
    flat = np.cos(elevation).ravel()
    rays = np.stack([flat * np.cos(azimuth).ravel(), flat * np.sin(azimuth).ravel(), np.sin(elevation).ravel()], axis=1)
    truth = {}
    for station, (x, y) in enumerate([(-8.0, -5.0), (-3.0, 0.5), (2.5, 3.0), (6.0, -4.5), (-8.5, 6.0)]):
        turn = rng.uniform(-np.pi, np.pi)
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        pose[:3, 3] = eye = np.array([x, y, 1.7])
        depth = cast(eye, rays @ pose[:3, :3].T, lows, highs, trees)
        hit = np.isfinite(depth) & (depth > 0.3)
        noisy = depth[hit] + rng.normal(scale=0.003, size=hit.sum())
        name = f"station_{station}.ply"
        write_ply(folder / name, noisy[:, None] * rays[hit])
        truth[name] = pose.tolist()
    (folder / "truth.json").write_text(json.dumps(truth))


def cast(eye: Array, rays: Array, lows: Array, highs: Array, trees: Array) -> Array:
    """Distance along every ray to the nearest box or upright cylinder, infinite without one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = np.full(len(rays), np.inf), np.full(len(rays), np.inf)
        for low, high in zip(lows, highs):
            a, b = (low - eye) / rays, (high - eye) / rays
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            near = np.where((enter <= leave) & (enter > 0), np.minimum(near, enter), near)
        for x, y, radius in trees:
            offset = eye[:2] - (x, y)
            a, b = (rays[:, :2] ** 2).sum(axis=1), rays[:, :2] @ offset
            inside = b**2 - a * (offset @ offset - radius**2)
            along = (-b - np.sqrt(inside)) / a
            height = eye[2] + along * rays[:, 2]
            ok = (inside > 0) & (along > 0) & (height > 0) & (height < 4)
            far = np.where(ok, np.minimum(far, along), far)
    nearest: Array = np.minimum(near, far)
    return nearest


def look_at(eye: Array, target: Array) -> Array:
    """world_from_camera of a camera at ``eye``: z forward, y down."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose


def write_ply(path: Path, points: Array) -> None:
    """A binary PLY of bare points."""
    path.parent.mkdir(parents=True, exist_ok=True)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())


if __name__ == "__main__":
    kind, place = sys.argv[1], Path(sys.argv[2])
    if kind == "turntable":
        turntable(place)
    else:
        terrestrial(place)
