"""Style and types, where the checkers are installed: scripts/setup brings them."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parent.parent
CHECKS = {
    'ruff': ['check'],
    'ruff format': ['format', '--check'],
    'mypy': [],
}


@pytest.mark.parametrize('check', CHECKS)
def test_checker_finds_nothing(check: str) -> None:
    tool = check.split()[0]
    pytest.importorskip(tool)
    command = [sys.executable, '-m', tool, *CHECKS[check]]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
