# SPDX-License-Identifier: Apache-2.0
"""The tutorials that need no nodes, and the notebook, do what they say."""

from __future__ import annotations

import json
from pathlib import Path
import re
import runpy

from herding_ros.studies import cli
import matplotlib
from page_code import blocks
import pytest

ROOT = Path(__file__).resolve().parents[1]


def printed_by(program: str, path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a program as a file of its own, and return what it prints."""
    path.write_text(program, encoding='utf-8')
    runpy.run_path(str(path))
    return capsys.readouterr().out


@pytest.mark.slow
def test_the_readme(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks('../README.md', 'python')
    arrived, time, distance, plans = printed_by(program, tmp_path / 'it.py', capsys).split()
    assert arrived == 'True'
    assert 70.0 < float(time) < 90.0
    assert float(distance) < 0.05
    assert abs(int(plans) - float(time)) < 5.0


def test_five_minutes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks('start.md', 'python')
    assert printed_by(program, tmp_path / 'first.py', capsys).startswith('True ')


def test_a_potential_and_a_cost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program = '\n'.join(blocks('tutorial_model.md', 'python'))
    said = printed_by(program, tmp_path / 'mine.py', capsys)
    for name in ('plain', 'watchful', 'careful'):
        assert f'{name}: home True' in said
    numbers = r'([\d.e+-]+|inf)'
    differences = re.search(f'off by {numbers} {numbers}', said)
    assert differences
    assert max(map(float, differences.groups())) < 1e-9
    plain, careful = map(float, re.findall(r'within ([\d.]+) m', said))
    assert plain < 0.15
    assert careful > 0.2
    orders = re.search(f'orders {numbers} {numbers} {numbers}', said)
    assert orders
    assert orders.group(1) == orders.group(3) == 'inf'
    assert float(orders.group(2)) > 1.9


COMMANDS = [line.split()[1:] for code in blocks('tutorial_paper.md') for line in code.splitlines()]


@pytest.mark.parametrize('words', COMMANDS, ids=' '.join)
def test_the_papers_table_may_be_asked_for(words: list[str], tmp_path: Path) -> None:
    """Each command of the page is one; without results it writes a page of gaps."""
    at = words.index('--out') + 1
    assert cli.main([*words[:at], str(tmp_path), '--draw']) == 0
    assert (tmp_path / f'{words[0]}.md').exists()


@pytest.mark.slow
def test_the_papers_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page's first command gives what the page promises, in a folder of the test's."""
    words = [word.replace('/tmp/table', str(tmp_path)) for word in COMMANDS[0]]
    assert cli.main([*words, '--jobs', '1']) == 0
    assert 'these sizes are tiny; without --quick: 48 min of one core' in capsys.readouterr().out
    table = (tmp_path / 'stochasticity.md').read_text(encoding='utf-8')
    assert re.search(r'^\| .*σ', table, re.M)
    assert (tmp_path / 'figures' / 'stochasticity-cost.png').exists()
    listing = blocks('tutorial_paper.md', 'python')[0].replace('/tmp/table', str(tmp_path))
    assert len(printed_by(listing, tmp_path / 'listing.py', capsys).splitlines()) == 3


def test_the_notebook_herds_in_ten_cells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    notebook = json.loads((ROOT / 'examples' / 'herd.ipynb').read_text(encoding='utf-8'))
    cells = notebook['cells']
    assert len(cells) == 10
    assert not any(cell.get('outputs') for cell in cells), 'clear the outputs before a commit'
    code = [''.join(cell['source']) for cell in cells if cell['cell_type'] == 'code']
    matplotlib.use('agg')
    said = printed_by('\n'.join(code), tmp_path / 'herd.py', capsys)
    assert said.count('home: True') == 3
