"""What is taken for a scan, and what is refused, with the words of the refusal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import scanweave

FAST = {"descriptor.kind": "fpfh"}
POINTS = np.random.default_rng(0).uniform(-1, 1, (3000, 3))


def keypoints(scan: Any, **options: Any) -> Any:
    """What is read from a scan: its keypoints tell its points."""
    return scanweave.describe({"one": scan}, config=FAST, **options)["one"].keypoints


def test_open3d_and_trimesh_objects_are_taken_by_what_they_have() -> None:
    expected = keypoints(POINTS)
    colors = np.full((3000, 4), 200, dtype=np.uint8)
    cloud = SimpleNamespace(points=POINTS.tolist(), colors=np.zeros((3000, 3)), normals=np.zeros((0, 3)))
    tensor = SimpleNamespace(point={"positions": SimpleNamespace(numpy=lambda: POINTS)})
    mesh = SimpleNamespace(vertices=POINTS, faces=[[0, 1, 2]], visual=SimpleNamespace(vertex_colors=colors))
    for held in (cloud, tensor, mesh, SimpleNamespace(vertices=POINTS, colors=colors)):
        assert np.array_equal(keypoints(held), expected)
    structured = np.zeros(3000, dtype=[("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "f4")])
    for axis, name in enumerate("xyz"):
        structured[name] = POINTS[:, axis]
    assert np.array_equal(keypoints(structured), expected)


def test_trimesh_itself() -> None:
    trimesh = pytest.importorskip("trimesh")
    expected = keypoints(POINTS)
    assert np.array_equal(keypoints(trimesh.PointCloud(POINTS)), expected)
    assert np.array_equal(keypoints(trimesh.Trimesh(POINTS, process=False)), expected)


def test_colors_of_every_kind_are_the_same(tmp_path: Path) -> None:
    colors = np.random.default_rng(1).integers(0, 256, (3000, 3), dtype=np.uint8)
    merged = []
    for value in (colors, colors / 255.0, colors.astype(np.int64), np.c_[colors, colors[:, :1]]):
        scans = {name: {"points": POINTS, "colors": value} for name in "ab"}
        merged.append(scanweave.register(scans, config=FAST).merged(voxel=0.3))
    found = [cloud.colors for cloud in merged if cloud.colors is not None]
    assert len(found) == 4 and found[0].std() > 1
    assert all(np.array_equal(other, found[0]) for other in found)


def test_georeferenced_coordinates_keep_millimetres() -> None:
    far = POINTS + [431_250.0, 5_812_345.0, 100.0]
    found, near = keypoints(far), keypoints(POINTS)
    assert np.abs(np.sort(found - [431_250.0, 5_812_345.0, 100.0], axis=0) - np.sort(near, axis=0)).max() < 1e-3


def test_a_file_is_read_with_what_it_does_not_say_itself(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.xyz", POINTS * 1000)
    scan = scanweave.read_scan(tmp_path / "a.xyz", config={"input.unit_m": 0.001})
    assert scan.name == "a" and scan.file == str(tmp_path / "a.xyz") and len(scan) == 3000
    assert np.abs(scan.points - POINTS).max() < 1e-6
    assert scan.colors is None and scan.normals is None and scan.initial_pose is None


def test_rows_that_are_not_finite_are_left_out_with_a_warning() -> None:
    holes = np.concatenate([POINTS, np.full((5, 3), np.nan)])
    with pytest.warns(scanweave.ScanweaveWarning, match=r"scans\['one'\]: left out 5 of 3005 points, not finite"):
        assert np.array_equal(keypoints(holes), keypoints(POINTS))


REFUSED: list[tuple[Any, str]] = [
    (np.zeros((0, 3)), r"scans\[0\]: found an array without a point, expected points of shape \(n, 3\), metres"),
    (np.full((9, 3), np.nan), r"scans\[0\]: found no finite point of 9, expected at least one point"),
    (np.zeros((9, 2)), r"scans\[0\]: found an array of shape \(9, 2\), expected points of shape \(n, 3\)"),
    (np.zeros((9, 4)), r"found an array of shape \(9, 4\).*pass points\[:, :3\]"),
    (np.zeros((4, 5, 3)), r"found an array of shape \(4, 5, 3\).*reshape\(-1, 3\)"),
    (np.zeros(3), r"found an array of shape \(3,\)"),
    (np.array([["a", "b", "c"]]), r"found values of type <U1, expected points.*pass a NumPy array of numbers"),
    (np.zeros((9, 3), dtype=complex), "found values of type complex128"),
    (7, r"found an array of shape \(\)"),
    (None, r"found an object of builtins.NoneType"),
    (object(), r"found an object of builtins.object"),
    ({"point": POINTS}, r"scans\[0\]: found the key 'point', expected keys among.*did you mean 'points'\?"),
    ({"colors": POINTS}, r"scans\[0\]: found no points, expected the key 'points'"),
    ({"points": POINTS, "colors": POINTS}, r"colors of scans\[0\]: found values from -.* to .*, expected shape"),
    ({"points": POINTS, "colors": POINTS[:5]}, r"colors of scans\[0\]: found an array of shape \(5, 3\)"),
    ({"points": POINTS, "normals": POINTS[:5]}, r"normals of scans\[0\]: found an array of shape \(5, 3\)"),
    ({"points": POINTS, "viewpoint": [0, 0]}, r"viewpoint of scans\[0\]: found an array of shape \(2,\)"),
    ({"points": POINTS, "viewpoint": [0, 0, np.inf]}, r"viewpoint of scans\[0\]: found \[0.0, 0.0, inf\]"),
    ({"points": POINTS, "initial_pose": np.eye(3)}, r"initial_pose of scans\[0\]: found an array of shape \(3, 3\)"),
    ({"points": POINTS, "initial_pose": 2 * np.eye(4)}, r"initial_pose of scan_0: found a matrix that is no rigid"),
    ({"points": POINTS, "initial_pose": np.full((4, 4), np.nan)}, "found a matrix that is no rigid motion"),
]


@pytest.mark.parametrize(("scan", "message"), REFUSED)
def test_what_cannot_be_a_scan_is_refused_in_words(scan: Any, message: str) -> None:
    with pytest.raises(scanweave.InputError, match=message) as raised:
        scanweave.register([scan, POINTS])
    assert isinstance(raised.value, ValueError) and isinstance(raised.value, scanweave.ScanweaveError)


def test_lists_that_cannot_be_registered() -> None:
    with pytest.raises(scanweave.InputError, match="inputs: found one scan, scan_0, expected at least two scans"):
        scanweave.register([POINTS], config=FAST)
    with pytest.raises(scanweave.InputError, match="found no scan"):
        scanweave.register({}, config=FAST)
    with pytest.raises(scanweave.InputError, match="scans: found an object of builtins.int"):
        scanweave.register(3)  # type: ignore[arg-type]
    with pytest.raises(scanweave.InputError, match="scans: found an object of numpy.ndarray"):
        scanweave.register(POINTS, config=FAST)
    with pytest.raises(scanweave.InputError, match="scans: found one scan as a dictionary.*put it in a list"):
        scanweave.register({"points": POINTS}, config=FAST)
    twice = [{"points": POINTS, "name": "a"}, {"points": POINTS, "name": "a"}]
    with pytest.raises(scanweave.InputError, match="scans: found the name 'a' twice, expected a name of its own"):
        scanweave.register(twice, config=FAST)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    missing = tmp_path / "gone.ply"
    for scans in ([missing, missing], [missing, POINTS], missing):
        with pytest.raises(scanweave.ReadError, match="gone.ply: cannot read it") as raised:
            scanweave.register(scans)
        assert isinstance(raised.value, OSError) and isinstance(raised.value, scanweave.InputError)
    (tmp_path / "bad.ply").write_text("ply\nformat nonsense\n")
    with pytest.raises(scanweave.InputError, match=r"bad.ply: found .*, expected .*; "):
        scanweave.read_scan(tmp_path / "bad.ply")


def test_settings_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(scanweave.SettingError, match="config: scale.voxel.*voxel_m"):
        scanweave.register([POINTS, POINTS], config={"scale.voxel": 0.1})
    with pytest.raises(scanweave.SettingError, match="scale.voxel_m: found -1"):
        scanweave.config({"scale": {"voxel_m": -1}})
    with pytest.raises(scanweave.SettingError, match="config: scale.voxel_m: found a (type|object)"):
        scanweave.config({"scale": {"voxel_m": object()}})
    with pytest.raises(scanweave.SettingError, match="--preset: found `best`, expected one of default, paper"):
        scanweave.config(preset="best")
    with pytest.raises(scanweave.ReadError, match="none.toml: cannot read it"):
        scanweave.config(tmp_path / "none.toml")
    with pytest.raises(scanweave.InputError, match="config: found an object of int"):
        scanweave.config(3)  # type: ignore[arg-type]
    with pytest.raises(scanweave.InputError, match="seed: found -1"):
        scanweave.config(seed=-1)
    with pytest.raises(scanweave.InputError, match="threads: found 0"):
        scanweave.register([POINTS, POINTS], threads=0)


def test_settings_in_every_spelling_are_the_same(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("seed = 5\n[scale]\nvoxel_m = 0.05\n")
    nested = scanweave.config({"scale": {"voxel_m": np.float32(0.05).item()}, "seed": np.int64(5)})
    dotted = scanweave.config({"scale.voxel_m": 0.05}, seed=5)
    assert scanweave.config(tmp_path / "my.toml") == dotted
    assert "voxel_m = 0.05" in nested.to_toml() and nested.seed == 5
    assert scanweave.config(dotted, seed=6).seed == 6 and scanweave.config(dotted) == dotted
    assert scanweave.config("paper").to_toml() == scanweave.config(preset="paper").to_toml()


def test_truth_that_does_not_fit() -> None:
    poses = {"a": np.eye(4), "b": np.eye(4), "c": None}
    truth = {name: np.eye(4) for name in "abc"}
    judged = scanweave.evaluate(poses, truth, max_translation_m=0.1)
    assert (judged.right_pairs, judged.judged_pairs, judged.placed, judged.total) == (1, 3, 2, 3)
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    judged = scanweave.evaluate({**poses, "b": turned}, truth, max_translation_m=0.1)
    assert judged.wrong_pairs == 1 and abs(judged.max_rotation_deg - 180) < 1e-6
    with pytest.raises(scanweave.InputError, match="truth: found no true pose for 'c'"):
        scanweave.evaluate(poses, {"a": np.eye(4), "b": np.eye(4)}, max_translation_m=0.1)
    with pytest.raises(scanweave.InputError, match="result: found a dictionary of poses, expected .*max_translation_m"):
        scanweave.evaluate(poses, truth)
    with pytest.raises(scanweave.InputError, match="max_rotation_deg: found -1"):
        scanweave.evaluate(poses, truth, max_translation_m=0.1, max_rotation_deg=-1)
