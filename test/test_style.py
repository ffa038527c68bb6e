# SPDX-License-Identifier: Apache-2.0
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


def test_every_source_names_its_licence() -> None:
    suffixes = {'.py', '.xml', '.yaml', '.toml', '.cfg', '.rviz'}
    folders = ('.', 'benchmark', 'config', 'examples', 'herding_ros', 'launch', 'rviz', 'test')
    paths = [*(ROOT / 'scripts').iterdir(), *(ROOT / '.ci').iterdir()]
    for folder in folders:
        found = (ROOT / folder).glob('*' if folder == '.' else '**/*')
        paths += [path for path in found if path.suffix in suffixes]
    sources = [path for path in paths if path.is_file() and path.stat().st_size]
    assert len(sources) > 200
    missing = [
        path.relative_to(ROOT).as_posix()
        for path in sources
        if 'SPDX-License-Identifier: Apache-2.0'
        not in ''.join(path.read_text(encoding='utf-8').splitlines(True)[:4])
    ]
    assert missing == []
