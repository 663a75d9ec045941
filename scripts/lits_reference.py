#!/usr/bin/env python3
"""Recomputes LITS (Yew & Lee 2021) on a small pose graph, in double precision and without
PyTorch: what tests/real_lits.rs compares the network with.

Usage: lits_reference.py WEIGHTS.pth > tests/fixtures/lits_NAME.json

WEIGHTS.pth is a file as the authors published it (the container PyTorch wrote before 1.6).
Needs numpy. The graph is made here, from a closed form, so that no data is needed.
"""

import collections
import json
import pickle
import sys

import numpy as np


def read_state(path):
    """Tensors of a legacy PyTorch file: pickled header, pickled object, storage keys, raw storages."""

    class Other:
        def __init__(self, *args, **kwargs):
            pass

    class Reader(pickle.Unpickler):
        def find_class(self, module, name):
            if name == "OrderedDict":
                return collections.OrderedDict
            if name == "_rebuild_tensor_v2":
                return lambda storage, offset, shape, stride, *rest: (storage[2], offset, shape, stride)
            return type(name, (Other,), {})

        def persistent_load(self, pid):
            return pid

    with open(path, "rb") as file:
        for _ in range(3):
            Reader(file).load()
        state = Reader(file).load()["state_dict"]
        storages = {}
        for key in Reader(file).load():
            count = int.from_bytes(file.read(8), "little")
            # Every storage of the file is 32 bits wide but for none that is read here.
            storages[key] = np.frombuffer(file.read(4 * count), "<f4")
    tensors = {}
    for name, (key, offset, shape, stride) in state.items():
        values = storages[key][offset : offset + int(np.prod(shape))].reshape(shape)
        assert list(stride) == [int(np.prod(shape[k + 1 :])) for k in range(len(shape))], name
        tensors[name.removeprefix("meta_op.")] = values.astype(np.float64)
    return tensors


def mlp(w, name, x):
    hidden = np.maximum(x @ w[f"{name}.0.weight"].T + w[f"{name}.0.bias"], 0)
    return hidden @ w[f"{name}.2.weight"].T + w[f"{name}.2.bias"]


def hat(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def se3(v, omega):
    """exp of a twist, by the closed form."""
    angle = np.linalg.norm(omega)
    o = hat(omega)
    if angle < 1e-12:
        rotation, left = np.eye(3) + o, np.eye(3)
    else:
        s, c = np.sin(angle), np.cos(angle)
        rotation = np.eye(3) + s / angle * o + (1 - c) / angle**2 * o @ o
        left = np.eye(3) + (1 - c) / angle**2 * o + (angle - s) / angle**3 * o @ o
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, left @ v
    return pose


def lits(w, n, edges, rounds=10):
    """edges: (i, j, j_from_i). Returns scan_from_world of every node."""
    poses = [np.eye(4) for _ in range(n)]
    x, u = np.zeros((n, 16)), np.zeros((1, 4))
    for _ in range(rounds):
        u = mlp(w, "global_model.global_mlp", np.concatenate([u, x.mean(0, keepdims=True)], 1))
        rows, target = [], []
        for i, j, measured in edges:
            for a, b, b_from_a in [(i, j, measured), (j, i, np.linalg.inv(measured))]:
                error = poses[b] @ np.linalg.inv(poses[a]) @ np.linalg.inv(b_from_a)
                rows.append(np.concatenate([x[a], x[b], error[:3, :].T.reshape(-1)]))
                target.append(b)
        rows, target = np.array(rows), np.array(target)
        features = np.maximum(mlp(w, "node_model.node_mlp_1", rows), 0)
        votes = np.maximum(mlp(w, "node_model.weights_mlp_1", rows), 0)
        strongest = np.array([votes[target == node].max(0) for node in range(n)])
        logits = mlp(w, "node_model.weights_mlp_2", np.concatenate([votes, strongest[target]], 1))
        features = features / (1 + np.exp(-logits))
        pooled = np.array([features[target == node].sum(0) for node in range(n)])
        pooled = pooled / (np.linalg.norm(pooled, axis=1, keepdims=True) + 1e-4)
        out = mlp(w, "node_model.node_mlp_2", np.concatenate([pooled, x, np.repeat(u, n, 0)], 1))
        x = x + out[:, :16]
        for node in range(n):
            v, omega = out[node, 16:19], out[node, 19:]
            size = np.linalg.norm(omega)
            omega = np.pi * size**2 / (1 + size**2) * omega / max(size, 1e-300)
            poses[node] = se3(v, omega) @ poses[node]
    return poses


def small_graph(n=6):
    """Poses and a few wrong edges from sines: the same in any language."""
    poses = [
        se3(np.array([1.5 * np.sin(k), np.cos(2 * k), 0.5 * np.sin(3 * k)]),
            np.array([0.6 * np.sin(1 + k), 0.5 * np.cos(k), 0.7 * np.sin(2 * k)]))
        for k in range(n)
    ]
    edges = []
    for i in range(n):
        for j in range(i + 1, n):
            if (i + 2 * j) % 5 == 0:
                continue
            motion = np.linalg.inv(poses[i]) @ poses[j]
            if (i + j) % 7 == 0:
                motion = se3(np.array([1.0, -0.5, 0.25 * i]), np.array([0.3 * j, 1.0, -0.4])) @ motion
            edges.append((i, j, motion))
    return edges


def main():
    weights = read_state(sys.argv[1])
    n = 6
    # i_from_j in, world_from_scan out, as the Rust side has them.
    edges = small_graph(n)
    found = lits(weights, n, [(i, j, np.linalg.inv(m)) for i, j, m in edges])
    world = [np.linalg.inv(p) for p in found]
    relative = [np.linalg.inv(world[0]) @ p for p in world]
    json.dump(
        {
            "edges": [{"i": i, "j": j, "i_from_j": m.tolist()} for i, j, m in edges],
            "first_from_scan": [m.tolist() for m in relative],
        },
        sys.stdout,
        indent=1,
    )
    print()


if __name__ == "__main__":
    main()
