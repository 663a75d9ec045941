"""The stages on a local Ray cluster of two workers: the bytes of one process, with workers that are killed too."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest
from conftest import command, same

import scanweave
import scanweave.ray as on_ray

FILES = ("poses.json", "merged.ply", "trajectory.log", "overlap.csv", "config.toml", "registration.html")
#: Few enough that first pairs are not all pairs.
SETTINGS = {"registration.strategy.neighbours": 2}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Ray with two workers on this machine."""
    ray = pytest.importorskip("ray", reason="Ray is not installed here: pip install 'scanweave[ray]'")
    ray.init(num_cpus=2, include_dashboard=False)
    yield ray
    ray.shutdown()


@pytest.fixture(scope="module")
def whole(room_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process of the command makes."""
    folder = tmp_path_factory.mktemp("whole") / "result"
    setting = "registration.strategy.neighbours=2"
    done = command("register", room_folder, "-o", folder, "--seed", 3, "--set", setting)
    assert done.returncode == 0, done.stderr
    return folder


def same_bytes(one: Path, other: Path) -> None:
    for file in FILES:
        assert (one / file).read_bytes() == (other / file).read_bytes(), file


Task = Callable[[Any, tuple[int, int]], None]


def killed_once(task: Task, shard: int, after: float, attempts: Path) -> Task:
    """A task whose worker is killed while it works on its first attempt at a shard."""

    def attempt(job: Any, part: tuple[int, int]) -> None:
        if part[0] == shard:
            with attempts.open("a") as file:
                file.write(f"{os.getpid()}\n")
            if len(attempts.read_text().splitlines()) == 1:
                threading.Timer(after, os.kill, (os.getpid(), signal.SIGKILL)).start()
        task(job, part)

    return attempt


def test_two_workers_give_the_bytes_of_one_process(
    cluster: Any, room_folder: Path, whole: Path, tmp_path: Path
) -> None:
    told: list[tuple[str, int, int]] = []
    output = tmp_path / "result"
    result = on_ray.register(
        room_folder,
        output=output,
        shards=3,
        config=SETTINGS,
        seed=3,
        progress=lambda *event: told.append(event),
    )
    same_bytes(output, whole)
    alone = scanweave.register(room_folder, config=SETTINGS, seed=3)
    assert isinstance(result, scanweave.Result) and same(result, alone)
    assert np.array_equal(result.predicted_overlap, alone.predicted_overlap)
    for stage in ("features", "pairs"):
        assert [event for event in told if event == (f"shards of {stage}", 3, 3)], told
    report = json.loads((output / "report.json").read_text())
    assert all(size["features_reused"] for size in report["sizes"])

    # The folder holds a result; what stages left is taken over.
    with pytest.raises(scanweave.OutputError, match="already holds a result; pass force=True"):
        on_ray.register(room_folder, output=output, config=SETTINGS, seed=3)
    files = [path for path in (output / "stages").rglob("*.npz")]
    times = [path.stat().st_mtime_ns for path in files]
    on_ray.register(room_folder, output=output, shards=3, config=SETTINGS, seed=3, force=True)
    assert [path.stat().st_mtime_ns for path in files] == times and len(files) == 6 + 12 + 3
    same_bytes(output, whole)


@pytest.mark.parametrize("stage", ["_describe", "_register"])
def test_a_killed_worker_changes_nothing(
    cluster: Any, room_folder: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    # Features of three scans take a second and more; pairs are killed before the first is there.
    after = 0.5 if stage == "_describe" else 0.0
    attempts = tmp_path / "attempts"
    monkeypatch.setattr(on_ray, stage, killed_once(getattr(on_ray, stage), 1, after, attempts))
    output = tmp_path / "result"
    on_ray.register(room_folder, output=output, shards=2, config=SETTINGS, seed=3)
    pids = attempts.read_text().split()
    assert len(pids) == 2 and pids[0] != pids[1]
    same_bytes(output, whole)
    leftovers = [path.name for path in (output / "stages").rglob(".scanweave-*")]
    assert not leftovers


def test_a_worker_that_always_dies_is_one_clear_error(
    cluster: Any, room_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dies(job: Any, part: tuple[int, int]) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    monkeypatch.setattr(on_ray, "_register", dies)
    with pytest.raises(scanweave.ScanweaveError, match="stage pairs, shard . of 2: found a task that ended 2 times"):
        on_ray.register(room_folder, output=tmp_path / "r", shards=2, max_retries=1, config={"descriptor.kind": "fpfh"})
    assert not (tmp_path / "r" / "poses.json").exists()


def test_errors_of_tasks_are_those_of_the_package(cluster: Any, room_folder: Path, tmp_path: Path) -> None:
    fpfh = {"descriptor.kind": "fpfh"}
    with pytest.raises(scanweave.InputError, match="paths, which all nodes"):
        on_ray.register([np.zeros((5, 3))], output=tmp_path / "r")  # type: ignore[list-item]
    with pytest.raises(scanweave.InputError, match="shards: found 0"):
        on_ray.register(room_folder, output=tmp_path / "r", shards=0)
    with pytest.raises(scanweave.ReadError):
        on_ray.register(tmp_path / "none", output=tmp_path / "r")
    with pytest.raises(scanweave.SettingError, match="found incremental"):
        on_ray.register(
            room_folder,
            output=tmp_path / "r",
            shards=2,
            config={"method": "multiview", "registration.strategy": {"kind": "incremental"}, **fpfh},
        )
    stages = tmp_path / "stages"
    on_ray.register(room_folder, output=tmp_path / "one", shards=2, stages=stages, config=fpfh)
    with pytest.raises(scanweave.OutputError, match="already holds"):
        on_ray.register(room_folder, output=tmp_path / "two", shards=2, stages=stages, config=fpfh, seed=8)


def test_without_ray_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r'pip install "scanweave\[ray\]"'):
        on_ray.register("scans", output=tmp_path / "r")
