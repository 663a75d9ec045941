"""What tests share: a synthetic room, read once and registered once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scanweave

COMMAND = [sys.executable, "-m", "scanweave"]


def command(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command of the package."""
    text = [str(argument) for argument in arguments]
    return subprocess.run([*COMMAND, *text], capture_output=True, text=True, **options)


@pytest.fixture(scope="session")
def room_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room of five scans and one of elsewhere, as files."""
    folder = tmp_path_factory.mktemp("room") / "set"
    done = command("synth", "-o", folder, "--rooms", 1, "--scans", 5, "--unrelated", 1, "--seed", 4)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="session")
def scans(room_folder: Path) -> list[scanweave.Scan]:
    return scanweave.read_scans(room_folder)


@pytest.fixture(scope="session")
def dicts(scans: list[scanweave.Scan]) -> list[dict[str, Any]]:
    """The scans as dictionaries of what the files hold."""
    keys = ("name", "points", "colors", "viewpoint", "initial_pose")
    return [{key: getattr(scan, key) for key in keys} for scan in scans]


@pytest.fixture(scope="session")
def result(scans: list[scanweave.Scan]) -> scanweave.Result:
    return scanweave.register(scans)


def poses_of(result: scanweave.Result) -> list[Any]:
    return list(result.poses.values())


def same(a: scanweave.Result, b: scanweave.Result) -> bool:
    """Whether all poses are the same bits."""
    pairs = list(zip(poses_of(a), poses_of(b)))
    same_number = len(a.poses) == len(b.poses)
    both = [(p is None, q is None) for p, q in pairs]
    equal = all(p is None or np.array_equal(p, q) for p, q in pairs)
    return same_number and equal and all(p == q for p, q in both)
