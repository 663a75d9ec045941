"""Makes scans as large as those of terrestrial scanners, to measure time and memory with.

Also a source of scans with all attributes for check-exports.sh. Each is a furnished room seen from a place in it: analytic surfaces with noise, sampled evenly by area and
cut to what the sensor faces. Written as binary little-endian PLY with normals, colours and intensities,
in the coordinates of the sensor, or moved from there by --origin with double precision; truth.json has the
poses. Needs numpy.

    big_scans.py OUT --scans 2 --points 20000000
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np

BLOCK = 1 << 20
ROOM = (9.0, 7.0, 3.2)


def row_of(coordinate):
    return np.dtype(
        [(n, coordinate) for n in ("x", "y", "z")]
        + [(n, "<f4") for n in ("nx", "ny", "nz")]
        + [(n, "u1") for n in ("red", "green", "blue")]
        + [("intensity", "<f4")]
    )


def boxes(rng):
    """The room, and furniture of different sizes along its walls: (low corner, high corner, inward)."""
    yield np.zeros(3), np.array(ROOM), True
    for _ in range(14):
        size = rng.uniform([0.3, 0.3, 0.4], [1.6, 1.2, 2.2])
        low = rng.uniform([0, 0, 0], np.array(ROOM) - size) * [1, 1, 0]
        yield low, low + size, False


def faces(rng):
    """Rectangles as (corner, edge, edge, normal, colour)."""
    result = []
    for low, high, inward in boxes(rng):
        size = high - low
        for axis in range(3):
            u, v = [k for k in range(3) if k != axis]
            for end in (0, 1):
                corner = low.copy()
                corner[axis] = (low, high)[end][axis]
                normal = np.eye(3)[axis] * (1 if bool(end) != inward else -1)
                colour = rng.integers(40, 240, 3)
                result.append((corner, np.eye(3)[u] * size[u], np.eye(3)[v] * size[v], normal, colour))
    return result


def block(rng, scene, weights, sensor, n, noise):
    corner, a, b, normal, colour = (np.array(column) for column in zip(*scene))
    face = rng.choice(len(scene), n, p=weights)
    s, t = rng.random((2, n, 1))
    points = corner[face] + s * a[face] + t * b[face]
    ray = points - sensor
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    # Only the side that the sensor faces is seen.
    cosine = -(ray * normal[face]).sum(axis=1) / distance[:, 0]
    seen = cosine > 0.05
    points, ray, distance, face, cosine = (x[seen] for x in (points, ray, distance, face, cosine))
    points = points + rng.normal(0, noise, (len(points), 1)) * ray / distance
    stripes = (np.sin(points * 9).sum(axis=1, keepdims=True) * 12).astype(int)
    return points, normal[face], (colour[face] + stripes).clip(0, 255), cosine


def write(path, rng, scene, pose, n, noise, origin):
    area = np.array([np.linalg.norm(np.cross(a, b)) for _, a, b, _, _ in scene])
    turn, sensor = pose[:3, :3], pose[:3, 3]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    words = {"<f4": "float", "<f8": "double", "|u1": "uchar"}
    row = row_of("<f8" if origin.any() else "<f4")
    lines += [f"property {words[row[name].str]} {name}" for name in row.names] + ["end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(lines).encode())
        while n:
            points, normals, colours, cosine = block(rng, scene, area / area.sum(), sensor, BLOCK, noise)
            rows = np.empty(min(n, len(points)), row)
            # Rows of row vectors: R^T (p - t) is (p - t) R.
            local = (points - sensor) @ turn + origin
            for k, name in enumerate("xyz"):
                rows[name] = local[: len(rows), k]
                rows["n" + name] = (normals @ turn)[: len(rows), k]
            for k, name in enumerate(("red", "green", "blue")):
                rows[name] = colours[: len(rows), k]
            rows["intensity"] = cosine[: len(rows)]
            file.write(rows.tobytes())
            n -= len(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scans", type=int, default=2)
    parser.add_argument("--points", type=int, default=20_000_000)
    parser.add_argument("--noise", type=float, default=0.002, help="along the ray, metres")
    parser.add_argument("--origin", type=float, nargs=3, default=[0, 0, 0], metavar=("X", "Y", "Z"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    scene = faces(rng)
    arguments.out.mkdir(parents=True, exist_ok=True)
    truth = {}
    for k in range(arguments.scans):
        angle = 0.9 * k
        pose = np.eye(4)
        pose[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        pose[:3, 3] = [2.5 + 3.5 * (k % 2), 2.5 + 0.8 * k % 3, 1.6]
        name = f"big_{k}.ply"
        origin = np.array(arguments.origin)
        write(arguments.out / name, rng, scene, pose, arguments.points, arguments.noise, origin)
        pose[:3, 3] -= pose[:3, :3] @ origin
        truth[name] = pose.tolist()
    (arguments.out / "truth.json").write_text(json.dumps(truth, indent=1))


if __name__ == "__main__":
    main()
