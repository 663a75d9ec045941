"""The command that comes along."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from conftest import command

import scanweave


def test_the_command_is_there_without_training() -> None:
    version = command("--version")
    assert version.returncode == 0 and version.stdout == f"scanweave {scanweave.__version__}\n"
    script = Path(sys.executable).with_name("scanweave")
    if script.exists() or shutil.which("scanweave"):
        shown = subprocess.run([script if script.exists() else "scanweave", "--help"], capture_output=True, text=True)
        assert "register" in shown.stdout and "import-weights" not in shown.stdout
    unknown = command("train")
    assert unknown.returncode == 2 and "unrecognized subcommand 'train'" in unknown.stderr


def test_exit_codes_are_those_of_the_command(tmp_path: Path) -> None:
    assert command("register", tmp_path / "none", "-o", tmp_path / "r").returncode == 3
    assert command("register", tmp_path, "-o", tmp_path / "r", "--set", "scale.voxel=1").returncode == 4
    assert command("completions", "bash").stdout.startswith("_scanweave")
