"""Registration: what comes out, and that it is the same whatever the scans are held in."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import same

import scanweave

FAST = {"descriptor.kind": "fpfh"}


def test_a_room_is_placed_and_what_is_elsewhere_declined(result: scanweave.Result, room_folder: Path) -> None:
    placed = [name for name, pose in result.poses.items() if pose is not None]
    assert len(result.poses) == 6 and len(result.components[0]) == 5
    outsider = (set(result.names) - set(result.components[0])).pop()
    outcome = result.outcomes[outsider]
    if outsider not in placed:
        assert outcome.reason and outcome.reason_code and outcome.pose is None
        assert result.declined == {outsider: outcome.reason}
    inside = result.outcomes[next(name for name in result.components[0] if result.outcomes[name].parent)]
    assert inside.evidence is not None and inside.probability is not None and inside.probability > 0.9
    assert inside.covariance is not None and np.linalg.eigvalsh(inside.covariance).min() > 0
    assert inside.parent in result.components[0] and inside.neighbours
    # The truth of the files; 5 degrees and three inlier radii are the limits of `scanweave evaluate`.
    judged = scanweave.evaluate(result, room_folder)
    assert (judged.right_pairs, judged.wrong_pairs, judged.judged_pairs) == (10, 0, 15)
    assert judged.max_rotation_deg < 1 and judged.max_translation_m < 0.02


def blocks(path: Path, rows: int) -> list[tuple[int, int, Any]]:
    """Matrices of a Redwood log, each after a line that names its two scans."""
    lines = path.read_text().splitlines()
    numbers = [[float(word) for word in line.split()] for line in lines]
    return [
        (int(numbers[at][0]), int(numbers[at][1]), np.array(numbers[at + 1 : at + 1 + rows]))
        for at in range(0, len(lines), rows + 1)
    ]


def test_recall_of_a_benchmark_is_that_of_its_protocol(result: scanweave.Result, room_folder: Path) -> None:
    # Choi et al. 2015: the root mean square error of a pair by its information matrix, neighbours in time left out.
    truths, information = blocks(room_folder / "gt.log", 4), blocks(room_folder / "gt.info", 6)
    numbered = {int(name.rsplit("_", 1)[-1]): pose for name, pose in result.poses.items()}
    errors = []
    for (i, j, truth), (_, _, weight) in zip(truths, information):
        one, other = numbered[i], numbered[j]
        if j <= i + 1:
            continue
        if one is None or other is None:
            errors.append(np.inf)
            continue
        off = np.linalg.inv(truth) @ np.linalg.inv(one) @ other
        w = np.sqrt(max(1 + np.trace(off[:3, :3]), 0)) / 2
        axis = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / (4 * w)
        step = np.concatenate([off[:3, 3], axis])
        errors.append(np.sqrt(step @ weight @ step / weight[0, 0]))
    assert len(errors) > 2
    for threshold in (0.2, float(np.median(errors))):
        judged = scanweave.evaluate(result, room_folder, benchmark=room_folder, threshold_m=threshold + 1e-9)
        assert judged.registration_recall == pytest.approx(np.mean(np.array(errors) <= threshold + 1e-9))
    with pytest.raises(scanweave.ScanweaveError, match="gt.log"):
        scanweave.evaluate(result, room_folder, benchmark=room_folder / "PointCloud")


def test_poses_are_rigid_motions_from_scans_to_their_component(
    result: scanweave.Result, scans: list[scanweave.Scan]
) -> None:
    by_name = {scan.name: scan for scan in scans}
    merged = result.merged(voxel=0.05)
    low, high = merged.points.min(axis=0) - 0.1, merged.points.max(axis=0) + 0.1
    for name in result.components[0]:
        pose = result.poses[name]
        assert pose is not None
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        moved = by_name[name].points @ pose[:3, :3].T + pose[:3, 3]
        assert (moved > low).all() and (moved < high).all()


def test_the_parent_s_pose_is_that_of_the_evidence(result: scanweave.Result) -> None:
    # Later refinement moves scans by little: the quaternion's order and the direction must be right for that.
    for outcome in result.outcomes.values():
        if outcome.parent is None or outcome.evidence is None or outcome.evidence.parent_from_scan is None:
            continue
        parent, pose = result.poses[outcome.parent], outcome.pose
        assert parent is not None and pose is not None
        final = np.linalg.inv(parent) @ pose
        assert np.abs(final - outcome.evidence.parent_from_scan).max() < 0.1


def variants(dicts: list[dict[str, Any]], kind: str) -> Any:
    def changed(points: np.ndarray) -> Any:
        if kind == "non-contiguous":
            wide = np.zeros((len(points), 7))
            wide[:, 1:7:2] = points
            return wide[:, 1:7:2]
        if kind == "column-major":
            return np.asfortranarray(points)
        if kind == "big-endian":
            return points.astype(">f8")
        if kind == "single":
            return points.astype(np.float32)
        return points

    return [{**scan, "points": changed(scan["points"])} for scan in dicts]


@pytest.mark.parametrize("kind", ["double", "single", "non-contiguous", "column-major", "big-endian"])
def test_arrays_of_any_layout_are_the_points_of_the_files(
    scans: list[scanweave.Scan], dicts: list[dict[str, Any]], kind: str
) -> None:
    # Coordinates of the files are single precision near zero: nothing is lost either way.
    expected = scanweave.describe(scans[:2], config=FAST)
    found = scanweave.describe(variants(dicts[:2], kind), config=FAST)
    for name, features in expected.items():
        assert len(features.keypoints) > 500
        assert np.array_equal(found[name].keypoints, features.keypoints)
        assert np.array_equal(found[name].descriptors, features.descriptors)


def test_a_dictionary_of_names_and_a_mixed_list(
    dicts: list[dict[str, Any]], scans: list[scanweave.Scan], room_folder: Path
) -> None:
    result = scanweave.register(scans, config=FAST)
    named = {f"n{i}": {k: v for k, v in d.items() if k != "name"} for i, d in enumerate(dicts)}
    by_name = scanweave.register(named, config=FAST)
    assert by_name.names == [f"n{i}" for i in range(6)] and same(by_name, result)
    files = sorted((room_folder / "PointCloud").glob("*.ply"))
    mixed = scanweave.register([dicts[0], scans[1], files[2], str(files[3]), *dicts[4:]], config=FAST)
    assert mixed.names == result.names and same(mixed, result)


def test_bare_arrays_are_named_by_their_place(dicts: list[dict[str, Any]]) -> None:
    # Without the sensor's place, which is found out as far as the points tell.
    result = scanweave.register([scan["points"] for scan in dicts[:2]], config=FAST)
    assert result.names == ["scan_0", "scan_1"]


def test_order_threads_and_seed(result: scanweave.Result, scans: list[scanweave.Scan]) -> None:
    again = scanweave.register(scans[::-1], threads=1)
    for name, pose in result.poses.items():
        other = again.poses[name]
        if pose is None or other is None:
            assert pose is None and other is None
        else:
            assert np.array_equal(pose, other)
    assert "seed = 7" in scanweave.register(scans[:2], seed=7, config=FAST).config


def test_a_rough_pose_is_weighed(dicts: list[dict[str, Any]], result: scanweave.Result) -> None:
    poses = [result.poses[name] for name in result.components[0]]
    stated = [{**scan, "initial_pose": pose} for scan, pose in zip(dicts, poses)][:3]
    with_poses = scanweave.register(stated)
    assert "initial_poses = true" in with_poses.config
    # Given exactly right, nothing moves: the frame is that of the least motion.
    for scan, pose in zip(stated, with_poses.poses.values()):
        assert pose is not None and np.abs(pose - scan["initial_pose"]).max() < 0.05


def test_pair(scans: list[scanweave.Scan], result: scanweave.Result) -> None:
    a, b = (result.names.index(name) for name in result.components[0][:2])
    pair = scanweave.register_pair(scans[a], scans[b])
    assert pair.accepted and pair.reason is None and pair.target_from_source is not None
    target, source = poses = result.poses[scans[a].name], result.poses[scans[b].name]
    assert all(pose is not None for pose in poses)
    expected = np.linalg.inv(target) @ source  # type: ignore[arg-type, operator]
    assert np.abs(pair.target_from_source - expected).max() < 0.05
    outsider = next(s for s in scans if s.name not in result.components[0])
    declined = scanweave.register_pair(scans[a], outsider)
    assert not declined.accepted and declined.reason


def test_features_and_overlap(scans: list[scanweave.Scan], result: scanweave.Result) -> None:
    features = scanweave.describe(scans, config=FAST)
    assert list(features) == result.names
    for scan in scans:
        found = features[scan.name]
        assert found.keypoints.shape == (len(found.descriptors), 3) and found.descriptors.dtype == np.float32
        # Keypoints lie in the scan's own frame.
        assert (found.keypoints.min(axis=0) >= scan.points.min(axis=0) - 0.05).all()
        assert (found.keypoints.max(axis=0) <= scan.points.max(axis=0) + 0.05).all()
    overlap = scanweave.predict_overlap(scans)
    assert np.array_equal(overlap.values, result.predicted_overlap)
    assert np.array_equal(overlap.values, overlap.values.T) and overlap.names == result.names
    assert overlap[result.names[0], result.names[1]] == overlap.values[0, 1]


def test_progress_is_told_to_a_function_and_its_errors_stop_the_work(scans: list[scanweave.Scan]) -> None:
    told: list[tuple[str, int, int]] = []
    scanweave.describe(scans[:2], progress=lambda *event: told.append(event))
    assert ("surfaces", 0, 2) in told and ("features", 2, 2) in told

    def refuse(stage: str, done: int, total: int) -> None:
        raise RuntimeError(f"no {stage}")

    with pytest.raises(RuntimeError, match="no surfaces"):
        scanweave.describe(scans[:2], progress=refuse)


def test_progress_without_tqdm_is_a_line_a_stage(
    scans: list[scanweave.Scan], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    scanweave.describe(scans[:2], progress=True)
    assert "features (2)" in capfd.readouterr().err


def test_features_are_kept_for_the_next_call(scans: list[scanweave.Scan], tmp_path: Path) -> None:
    first = scanweave.register(scans[:3], cache=tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    assert kept and same(scanweave.register(scans[:3], cache=tmp_path), first)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_other_threads_run_meanwhile_and_ctrl_c_stops_the_work(room_folder: Path) -> None:
    script = f"""
import os, signal, sys, threading, time, scanweave
# A job in the background of a shell inherits that the signal is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
scans = scanweave.read_scans({str(room_folder)!r})
ticks = []
def tick():
    while len(ticks) < 10**6:
        ticks.append(time.monotonic())
        time.sleep(0.005)
threading.Thread(target=tick, daemon=True).start()
begun = []
def stop(stage, done, total):
    if stage == "features" and not begun:
        begun.append((time.monotonic(), len(ticks)))
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    scanweave.register(scans * 1, progress=stop)
except KeyboardInterrupt:
    stopped, (start, before) = time.monotonic(), begun[0]
    # The result of one more item may have to be waited for, a whole registration takes several seconds.
    print("stopped", stopped - start, len(ticks) - before)
    sys.exit(0)
sys.exit("not stopped")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    word, seconds, ticks = done.stdout.split()
    assert word == "stopped" and int(ticks) >= 5, done.stdout
