"""Holds the README's parameter tables against the code; run as a program, it writes them.

source scripts/env && python test/test_readme.py
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
import dataclasses
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Control
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.parameters import describe_limits, Parameters
from herding_ros.model.simulation import World
from herding_ros.nodes import recorder
from herding_ros.nodes.controller import ControllerSettings
from herding_ros.nodes.sim import SimSettings

README = Path(__file__).resolve().parents[1] / 'README.md'
BEGIN = '<!-- parameters: begin; written by test/test_readme.py -->\n'
END = '<!-- parameters: end -->\n'

Row = tuple[str, str, str, str, str]
HEAD: Row = ('name', 'default', 'unit', 'allowed', 'meaning')


def rows(
    defaults: Parameters, prefix: str = '', others: dict[str, Any] | None = None
) -> Iterator[Row]:
    """Yield a row for each field; a default that differs in one of `others` is named as well."""
    for field in dataclasses.fields(defaults):
        value = getattr(defaults, field.name)
        there = {name: getattr(other, field.name) for name, other in (others or {}).items()}
        if isinstance(value, Parameters):
            yield from rows(value, f'{prefix}{field.name}.', there)
            continue
        default = written(value)
        different = [f'`{name}`: {written(each)}' for name, each in there.items() if each != value]
        if different:
            default += f' ({", ".join(different)})'
        unit = field.metadata['unit']
        yield prefix + field.name, default, unit, describe_limits(field), field.metadata['doc']


def crowd_rows() -> Iterator[Row]:
    meaning = 'where the defaults of crowd.* come from'
    yield 'crowd.preset', written('cohesive'), '', ' or '.join(CROWDS), meaning
    yield from rows(CROWDS['cohesive'], 'crowd.', CROWDS)


def recorder_rows() -> Iterator[Row]:
    """Yield a row for each parameter; the recorder declares them in its constructor."""
    source = ast.parse(Path(recorder.__file__).read_text(encoding='utf-8'))
    calls = [node for node in ast.walk(source) if isinstance(node, ast.Call)]
    for call in sorted(calls, key=lambda call: call.lineno):
        if ast.unparse(call.func) != 'self._declare':
            continue
        name, default, meaning = call.args
        if isinstance(default, ast.Call):  # a name made from the time
            default = default.args[0]
        kinds = {list: 'texts', str: 'a text', int: 'an integer of at least 0'}
        allowed = kinds[type(ast.literal_eval(default))]
        unquoted = ast.unparse(default).strip("'")
        yield ast.literal_eval(name), f'`{unquoted}`', '', allowed, ast.literal_eval(meaning)


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
        table('sim: the world', rows(World())),
        table('sim: the node', rows(SimSettings())),
        table('controller: the node', rows(ControllerSettings())),
        table('controller: the method', rows(Control())),
        table('recorder', recorder_rows()),
    ]
    return '\n' + '\n'.join(tables) + '\n'


def parts(text: str) -> tuple[str, str, str]:
    """Split the README into what stands before, between and after the comments."""
    before, found, rest = text.partition(BEGIN)
    between, closed, after = rest.partition(END)
    assert found, f'{README} lacks the line {BEGIN!r}'
    assert closed, f'{README} lacks the line {END!r}'
    return before + BEGIN, between, END + after


def test_the_parameter_tables_are_those_of_the_code() -> None:
    between = parts(README.read_text(encoding='utf-8'))[1]
    wanted = section()
    assert between == wanted, (
        f'run `python test/test_readme.py`, or put this between the comments in {README.name}:\n'
        + wanted
    )


def test_the_recorder_has_the_parameters_that_the_table_looks_for() -> None:
    assert [row[0] for row in recorder_rows()] == [
        *('bag', 'topics', 'max_bag_size', 'max_bag_duration')
    ]


def test_local_links_lead_somewhere() -> None:
    root = README.parent
    for page in (README, *sorted((root / 'doc').glob('*.md'))):
        for link in links(page.read_text(encoding='utf-8')):
            assert (page.parent / link).exists(), f'{page.relative_to(root)} links to {link}'


def links(text: str) -> Iterator[str]:
    """Yield the targets of Markdown links and pictures, without those on the web."""
    for piece in text.split('](')[1:]:
        target = piece.split(')')[0].split('#')[0]
        if target and '://' not in target:
            yield target


if __name__ == '__main__':
    before, _, after = parts(README.read_text(encoding='utf-8'))
    README.write_text(before + section() + after, encoding='utf-8')
    print(f'wrote the parameter tables of {README}')
