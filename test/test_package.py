# SPDX-License-Identifier: Apache-2.0
"""The package as others use it: its public names, its description, its examples."""

from __future__ import annotations

import ast
import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

import herding_ros
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / 'examples').glob('*.py'))


def test_every_public_name_can_be_imported() -> None:
    for name in herding_ros.__all__:
        assert getattr(herding_ros, name) is not None
    assert set(herding_ros.__all__) <= set(dir(herding_ros))
    with pytest.raises(AttributeError, match="'herding_ros' has no attribute 'wolves'"):
        _ = herding_ros.wolves


def test_type_checkers_see_the_same_names() -> None:
    source = ast.parse(Path(herding_ros.__file__).read_text(encoding='utf-8'))
    block = next(node for node in source.body if isinstance(node, ast.If))
    seen = {
        alias.name
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == set(herding_ros.__all__) == set(herding_ros._MODULES)


def test_importing_the_package_loads_no_model() -> None:
    program = 'import herding_ros, sys; print("numpy" in sys.modules, "numba" in sys.modules)'
    out = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True
    )
    assert out.stdout.split() == ['False', 'False']


def test_compiled_packages_are_kept_in_our_environment() -> None:
    """Else each start of a program compiles NumPy, SciPy and Numba anew, for 2 s."""
    told = 'python -c "import sys; print(sys.dont_write_bytecode)"'
    out = subprocess.run(
        ['bash', '-c', f'. {ROOT}/scripts/env 2>/dev/null; {told}'],
        env={**os.environ, 'PYTHONDONTWRITEBYTECODE': '1'},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert out.stdout.split() == ['False']


@pytest.mark.skipif(not (ROOT / 'install').exists(), reason='needs scripts/setup here')
def test_programs_are_found_in_our_environment() -> None:
    """Once, however often it is sourced."""
    script = f'. {ROOT}/scripts/env; . {ROOT}/scripts/env; which -a sim controller report'
    out = subprocess.run(['bash', '-c', script], capture_output=True, text=True, check=True)
    assert [Path(line).name for line in out.stdout.split()] == ['sim', 'controller', 'report']


def requirements(name: str) -> dict[str, str]:
    """Return what a file of requirements says of each package, without hashes and comments."""
    text = (ROOT / name).read_text(encoding='utf-8').replace('\\\n', ' ')
    lines = [re.split(r'\s#|\s--hash', line)[0].strip() for line in text.splitlines()]
    lines = [line.split(';')[0].strip() for line in lines if line[:1].isalpha()]
    return {re.split('[=<>]', line)[0].lower(): line.lower() for line in lines}


@pytest.mark.parametrize(
    ('lock', 'sources'),
    [
        ('requirements.lock', ['requirements.txt', 'requirements-ros.txt']),
        ('requirements-cluster.lock', ['requirements-cluster.txt']),
        ('requirements-browser.lock', ['requirements-browser.txt']),
        ('requirements-rerun.lock', ['requirements-rerun.txt']),
        ('requirements-audit.lock', ['requirements-audit.txt']),
        ('requirements-site.lock', ['requirements-site.txt']),
    ],
)
def test_every_requirement_is_locked(lock: str, sources: list[str]) -> None:
    """At the version that it is pinned to; and nothing in a lock is without a hash."""
    locked = requirements(lock)
    for name, wanted in [pair for source in sources for pair in requirements(source).items()]:
        assert name in locked, f'{name}: run scripts/lock'
        assert '==' not in wanted or locked[name] == wanted, f'{wanted}: run scripts/lock'
    text = (ROOT / lock).read_text(encoding='utf-8').replace('\\\n', ' ')
    entries = [line for line in text.splitlines() if line[:1].isalpha()]
    assert all('==' in entry and '--hash=sha256:' in entry for entry in entries)


def test_the_version_is_that_of_the_manifest() -> None:
    manifest = ElementTree.parse(ROOT / 'package.xml')
    version = manifest.findtext('version')
    assert version == herding_ros.__version__
    assert f'\nversion: {version}\n' in (ROOT / 'CITATION.cff').read_text('utf-8')
    assert f'\n{version} (' in (ROOT / 'CHANGELOG.rst').read_text('utf-8')
    assert f'version = {{{version}}}' in (ROOT / 'doc' / 'cite.md').read_text('utf-8')


@pytest.mark.parametrize('path', (ROOT / '.github' / 'ISSUE_TEMPLATE').glob('[!c]*.yml'))
def test_issue_templates_are_forms(path: Path) -> None:
    form = yaml.safe_load(path.read_text(encoding='utf-8'))
    assert {'name', 'description', 'body'} <= form.keys()
    questions = [part for part in form['body'] if part['type'] != 'markdown']
    assert all(part['attributes']['label'] for part in questions)
    assert len({part['id'] for part in questions}) == len(questions)


def printed_by(name: str, folder: Path) -> str:
    path = ROOT / 'examples' / name
    return subprocess.run(
        [sys.executable, str(path)], cwd=folder, capture_output=True, text=True, check=True
    ).stdout


def test_examples_are_short() -> None:
    assert len(EXAMPLES) == 3
    assert all(len(path.read_text(encoding='utf-8').splitlines()) <= 45 for path in EXAMPLES)


def test_example_keeps_dogs_apart(tmp_path: Path) -> None:
    without, spaced = map(
        float, re.findall(r'closest ([\d.]+) m', printed_by('keep_dogs_apart.py', tmp_path))
    )
    assert spaced > without + 0.02


def test_example_compares_policies(tmp_path: Path) -> None:
    lines = printed_by('own_policy.py', tmp_path).splitlines()
    assert [line.split(':')[0] for line in lines] == ['policy', 'optimal control']
    assert all('True' in line for line in lines)
