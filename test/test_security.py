# SPDX-License-Identifier: Apache-2.0
"""Nothing in the sources turns data into code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(
    path
    for folder in ('herding_ros', 'launch', 'benchmark')
    for path in (ROOT / folder).rglob('*.py')
)

CODE_FROM_DATA = {
    'eval', 'exec', 'compile', '__import__', 'execfile',
    'os.system', 'os.popen', 'subprocess.getoutput', 'subprocess.getstatusoutput',
    'yaml.load', 'yaml.load_all', 'yaml.full_load', 'yaml.full_load_all', 'yaml.unsafe_load',
    'yaml.unsafe_load_all',
}  # fmt: skip
MODULES = {'pickle', 'cPickle', '_pickle', 'dill', 'cloudpickle', 'joblib', 'marshal', 'shelve'}
ARGUMENTS = {'shell', 'allow_pickle'}


def dangers(source: str) -> Iterator[str]:
    """Yield what in a source could run what somebody else has written."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or '']
            full = {f'{node.module}.{alias.name}' for alias in node.names}
            yield from full & CODE_FROM_DATA
        elif isinstance(node, ast.Call):
            names = []
            called = ast.unparse(node.func)
            if called in CODE_FROM_DATA:
                yield called
            for argument in node.keywords:
                off = isinstance(argument.value, ast.Constant) and not argument.value.value
                if argument.arg in ARGUMENTS and not off:
                    yield f'{called}({argument.arg}=...)'
        else:
            continue
        yield from MODULES & {name.split('.')[0] for name in names}


def test_data_stays_data() -> None:
    found = {str(path): list(dangers(path.read_text(encoding='utf-8'))) for path in SOURCES}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    'source',
    [
        'import yaml\nyaml.load(text, Loader=yaml.Loader)',
        'from yaml import unsafe_load',
        'import pickle',
        'from pickle import loads',
        'np.load(path, allow_pickle=True)',
        'subprocess.run(words, shell=shell)',
        'eval("1")',
    ],
)
def test_dangers_are_found(source: str) -> None:
    """Guards the test above."""
    assert ROOT / 'herding_ros' / 'nodes' / 'recorder.py' in SOURCES
    assert len(list(dangers(source))) == 1
