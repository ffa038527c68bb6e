# SPDX-License-Identifier: Apache-2.0
"""Holds the pages against the code. Run as a program, it writes the parameter tables.

source scripts/env && python test/test_pages.py
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
import importlib
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from herding_ros.control.parameters import Control, CONTROLS
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.motion import MOTIONS
from herding_ros.model.parameters import describe_limits, Parameters
from herding_ros.model.simulation import World
from herding_ros.nodes.herd import _parser
from herding_ros.nodes.settings import (
    ControllerSettings,
    ControlPreset,
    MotionKind,
    RecorderSettings,
    SimSettings,
    ViewSettings,
)
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'herding_ros'
README, PARAMETERS = ROOT / 'README.md', ROOT / 'doc' / 'parameters.md'
PAGES = (README, ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'doc').glob('*.md')))
BEGIN = '<!-- parameters: begin; written by test/test_pages.py -->\n'
END = '<!-- parameters: end -->\n'

Row = tuple[str, str, str, str, str]
HEAD: Row = ('name', 'default', 'unit', 'allowed', 'meaning')


def rows(
    defaults: Parameters, prefix: str = '', others: dict[str, Any] | None = None
) -> Iterator[Row]:
    """Yield a row for each value; a default that differs in one of `others` is named as well."""
    there = {key: other.flat(prefix) for key, other in (others or {}).items()}
    for name, value, field in defaults.walk(prefix):
        default = written(value)
        different = [
            f'`{key}`: {written(values[name]) if name in values else "none"}'
            for key, values in there.items()
            if values.get(name) != value
        ]
        if different:
            default += f' ({", ".join(different)})'
        unit = field.metadata['unit']
        yield name, default, unit, describe_limits(field), field.metadata['doc']


def crowd_rows() -> Iterator[Row]:
    meaning = 'where the defaults of crowd.* come from'
    yield 'crowd.preset', written('cohesive'), '', ' or '.join(CROWDS), meaning
    yield from rows(CROWDS['cohesive'], 'crowd.', CROWDS)
    known = Crowd().flat('crowd.')
    for preset, crowd in CROWDS.items():
        for name, default, *rest in rows(crowd, 'crowd.'):
            if name not in known:
                yield name, f'(`{preset}`: {default})', *rest


def motion_rows() -> Iterator[Row]:
    yield from rows(MotionKind(), 'motion.')
    for kind, motion in MOTIONS.items():
        for name, default, *rest in rows(motion, 'motion.'):
            yield name, f'(`{kind}`: {default})', *rest


def control_rows() -> Iterator[Row]:
    yield from rows(ControlPreset())
    yield from rows(Control(), others=CONTROLS)


def written(value: Any) -> str:
    """Return a value as one writes it in a parameter file."""
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    if isinstance(value, tuple):
        return f'`[{", ".join(map(str, value))}]`'
    return f'`{value}`' if value != '' else "`''`"


def escaped(cell: str) -> str:
    """Return a cell with what would end it or make it slanted taken by the letter."""
    return cell.replace('|', r'\|').replace('*', r'\*')


def table(title: str, content: Iterator[Row]) -> str:
    lines = [HEAD, ('---',) * len(HEAD)]
    lines += [(f'`{name}`', *map(escaped, cells)) for name, *cells in content]
    return f'#### {title}\n\n' + '\n'.join(f'| {" | ".join(line)} |' for line in lines) + '\n'


def section() -> str:
    """Return what stands between the two comments."""
    assert Crowd() == CROWDS['cohesive']
    tables = [
        table('sim and controller: the sheep', crowd_rows()),
        table('sim and controller: how dogs move', motion_rows()),
        table('sim: the world', rows(World())),
        table('sim: the node', rows(SimSettings())),
        table('controller: the node', rows(ControllerSettings())),
        table('controller: the method', control_rows()),
        table('recorder', rows(RecorderSettings())),
        table('view', rows(ViewSettings())),
    ]
    return '\n' + '\n'.join(tables) + '\n'


def parts(text: str) -> tuple[str, str, str]:
    """Split the page into what stands before, between and after the comments."""
    before, found, rest = text.partition(BEGIN)
    between, closed, after = rest.partition(END)
    assert found, f'{PARAMETERS} lacks the line {BEGIN!r}'
    assert closed, f'{PARAMETERS} lacks the line {END!r}'
    return before + BEGIN, between, END + after


def test_the_parameter_tables_are_those_of_the_code() -> None:
    between = parts(PARAMETERS.read_text(encoding='utf-8'))[1]
    expected = section()
    assert between == expected, (
        f'run `python test/test_pages.py`, or put this between the comments in {PARAMETERS}:\n'
        + expected
    )


def test_each_page_is_in_the_navigation_and_within_two_clicks() -> None:
    """Of the site, where doc/index.md is its home, and of the README."""
    index = (ROOT / 'doc' / 'index.md').read_text(encoding='utf-8')
    found = re.findall(r'```\{toctree\}\n(?::.*\n)*\n([^`]*)```', index)
    named = {line.rpartition('<')[2].rstrip('>') for tree in found for line in tree.split('\n')}
    pages = {path.stem for path in (ROOT / 'doc').glob('*.md')}
    assert named - {''} == pages - {'index'}, 'doc/index.md must name each page once'
    linked = {README}
    for _ in range(2):
        linked |= {
            (page.parent / file).resolve()
            for page in linked
            for file, _ in links(page.read_text(encoding='utf-8'))
            if file.endswith('.md')
        }
    lost = pages - {path.stem for path in linked} - ONLY_ON_THE_SITE
    assert not lost, f'no page that the README links to links to {lost}'


ONLY_ON_THE_SITE = {'index', 'contributing', 'changelog'}
"""Pages that show what stands elsewhere."""


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding='utf-8').splitlines()) <= 150


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    for file, anchor in links(page.read_text(encoding='utf-8')):
        target = page.parent / file if file else page
        assert target.exists(), f'{page.name} links to {file}'
        if anchor:
            found = anchors(target.read_text(encoding='utf-8'))
            assert anchor in found, f'{page.name} links to {file}#{anchor}'


def links(text: str) -> Iterator[tuple[str, str]]:
    """Yield file and anchor of Markdown links and pictures, without those on the web."""
    for target in re.findall(r'\]\(([^)]+)\)', text):
        if '://' not in target:
            file, _, anchor = target.partition('#')
            yield file, anchor


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r'^#+ (.*)$', re.sub(r'```.*?```', '', text, flags=re.S), re.M)
    return {re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-') for title in titles}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_examples_import_what_there_is(page: Path) -> None:
    for program in re.findall(r'```python\n(.*?)```', page.read_text(encoding='utf-8'), re.S):
        for node in ast.walk(ast.parse(program)):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                module = importlib.import_module(node.module)
                for alias in node.names:
                    assert hasattr(module, alias.name), f'{node.module} lacks {alias.name}'


HOMES = r'model|control|nodes|bag|report|studies'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_the_files_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    for name in re.findall(rf'`((?:{HOMES})/[\w/]+\.py)`', text):
        assert (PACKAGE / name).exists(), f'{page.name} names {name}'
    for name in re.findall(r'`((?:config|test|scripts|benchmark|launch)/[\w/]*(?:\.\w+)?)`', text):
        assert (ROOT / name).exists(), f'{page.name} names {name}'


def test_the_topics_and_services_are_those_of_the_nodes() -> None:
    """By config/sros2_policy.xml, which another test compares with live nodes."""
    policy = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').iter()
    there: dict[str, set[str]] = {'topic': set(), 'service': set()}
    node = ''
    for each in policy:
        node = each.get('node', node)
        if each.tag in there:
            name = str(each.text).replace('~', node).replace('*', '<i>')
            there[each.tag].add(name)
    there['topic'] -= {'<i>', '/parameter_events', '/rosout'}
    there['service'] = {name for name in there['service'] if 'parameter' not in name}
    text = (ROOT / 'doc' / 'interface.md').read_text(encoding='utf-8')
    topics, services = (
        {
            name
            for row in re.findall(r'^\| (`.*?`) \|', part, re.M)
            for name in row[1:-1].split('`, `')
        }
        for part in re.split(r'^## (?:Services|Diagnostics)$', text, flags=re.M)[:2]
    )
    assert topics == there['topic']
    assert services == {name for name in there['service'] if 'description' not in name}


NO_ROWS = {'crowd.length', 'crowd.time', 'crowd.png', 'reference.speed'}
"""What scales a preset, the picture of `fit`, and what studies.md calls gone."""


def test_the_parameters_that_pages_name_exist() -> None:
    table = PARAMETERS.read_text(encoding='utf-8')
    names = set(re.findall(r'^\| `([\w.]+)` \|', table, re.M))
    groups = '|'.join({name.split('.')[0] for name in names if '.' in name})
    for page in PAGES:
        text = page.read_text(encoding='utf-8')
        for name in set(re.findall(rf'`((?:{groups})\.[\w.]*\w)(?::=?[^`]*)?`', text)) - NO_ROWS:
            there = any(f'{each}.'.startswith(f'{name}.') for each in names)
            assert there or name.endswith(('.py', '.yaml')), f'{page.name} names {name}'


def test_every_option_of_herd_is_explained() -> None:
    text = (ROOT / 'doc' / 'running.md').read_text(encoding='utf-8')
    table = text.partition('## One command')[2].partition('\n## ')[0]
    options = {option for action in _parser()._actions for option in action.option_strings}
    options -= {'-h', '--help', '--parameter'}  # the last is -p
    missing = {option for option in options if not re.search(rf'`{option}\b', table)}
    assert not missing, f'doc/running.md lacks {missing}'


def test_each_file_is_on_the_map() -> None:
    """A row names files of one folder, the folder with the first of them; `*.py` is all."""
    text = (ROOT / 'doc' / 'packages.md').read_text(encoding='utf-8')
    on_the_map: set[Path] = set()
    for row in re.findall(r'^\| (`.*?`) \|', text.partition('## Where')[0], re.M):
        folder = PACKAGE
        for name in re.findall(r'`(.*?)`', row):
            folder = (PACKAGE / name).parent if '/' in name else folder
            pattern = name + '**/*.py' if name.endswith('/') else Path(name).name
            found = set((PACKAGE if name.endswith('/') else folder).glob(pattern))
            assert found, f'there is no {name}'
            on_the_map |= found
    files = {path for path in PACKAGE.rglob('*.py') if path.name != '__init__.py'}
    missing = sorted(str(path.relative_to(PACKAGE)) for path in files - on_the_map)
    assert not missing, f'doc/packages.md lacks {missing}'


def test_each_promise_has_the_tests_that_it_names() -> None:
    """Entries are `file`: `test_name`, where … stands for the rest of the name."""
    text = (ROOT / 'doc' / 'reliability.md').read_text(encoding='utf-8')
    sources = {path.name: path.read_text('utf-8') for path in (ROOT / 'test').rglob('*.py')}
    for name in re.findall(r'`(test_\w+\.py)`', text):
        assert name in sources, f'there is no {name}'
    for name in re.findall(r'`(test_\w+?)_?(?:…)?`', text):
        assert any(f'def {name}' in source for source in sources.values()), name


if __name__ == '__main__':
    before, _, after = parts(PARAMETERS.read_text(encoding='utf-8'))
    PARAMETERS.write_text(before + section() + after, encoding='utf-8')
    print(f'wrote the tables of {PARAMETERS}')
