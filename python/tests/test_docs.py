"""The code of the pages runs and prints what they show; it and the examples are typed."""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import command

ROOT = Path(__file__).parent.parent
PAGES = ["index", "room", "turntable", "terrestrial"]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: str) -> list[tuple[str, str]]:
    """Language and text of every block of a page."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    return [(match[1], match[2]) for match in FENCE.finditer(text)]


def prepare(page: str) -> None:
    """Runs the commands of the page that make its data."""
    for language, text in blocks(page):
        for line in text.splitlines() if language == "sh" else []:
            if line.startswith("scanweave synth"):
                assert command(*line.split()[1:]).returncode == 0, line
            elif line.startswith("python make_data.py"):
                script = str(ROOT / "docs" / "make_data.py")
                subprocess.run([sys.executable, script, *line.split()[2:]], check=True)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_prints_what_it_shows(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(page)
    namespace: dict[str, Any] = {}
    printed, compared = "", 0
    for language, text in blocks(page):
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, f"{page}.md", "exec"), namespace)
            printed = out.getvalue()
        elif language == "text":
            assert printed == text, f"{page}.md prints\n{printed}and shows\n{text}"
            compared += 1
    assert compared >= 4


def test_pages_and_examples_are_typed(tmp_path: Path) -> None:
    api = pytest.importorskip("mypy.api")
    for page in PAGES:
        code = "\n".join(text for language, text in blocks(page) if language == "python")
        (tmp_path / f"page_{page}.py").write_text(code, encoding="utf-8")
    examples = [str(path) for path in sorted((ROOT / "examples").glob("*.py"))]
    assert examples
    out, errors, status = api.run(["--strict", str(tmp_path), *examples, "--cache-dir", str(tmp_path / "cache")])
    assert status == 0, out + errors


def test_the_example_registers_a_room_and_a_folder(room_folder: Path, tmp_path: Path) -> None:
    script = [sys.executable, str(ROOT / "examples" / "quickstart.py"), str(room_folder)]
    done = subprocess.run(script, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Result(5 of 5 scans placed, components: 1) 1.0" in done.stdout
    assert (tmp_path / "result" / "report.html").exists()
