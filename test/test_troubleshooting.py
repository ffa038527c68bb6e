# SPDX-License-Identifier: Apache-2.0
"""doc/troubleshooting.md: every warning in the code is explained, and nothing that nobody says."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
import re

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'herding_ros'
PAGE = (ROOT / 'doc' / 'troubleshooting.md').read_text(encoding='utf-8')
GAP = '…'
"""Stands for what differs from message to message, on the page as in a template."""

LOGS = {'warning', 'error', 'fatal', '_warn', '_warn_once', '_say'}
QUIET = {'info', 'debug'}
SHORTEST = 5


def template(node: ast.AST) -> str:
    """Return the text of an expression, with a gap for each part that is not constant."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return ''.join(template(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return GAP


def calls(*folders: str) -> Iterator[tuple[str, ast.Call]]:
    for path in (path for folder in folders for path in sorted((PACKAGE / folder).rglob('*.py'))):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Call):
                function = node.func
                name = function.attr if isinstance(function, ast.Attribute) else ''
                yield getattr(function, 'id', name), node


def warnings() -> Iterator[str]:
    """Yield what nodes and pilots say at the levels WARN, ERROR and FATAL, and what stops dogs."""
    for name, call in calls('nodes', 'control'):
        first, *others = call.args or [ast.Constant('')]
        text = template(first)
        if 'parser' in ast.unparse(call.func):  # ends with the usage
            continue
        if name in LOGS and text not in QUIET:
            yield template(call.args[-1])
            continue
        to_stderr = any(word.arg == 'file' for word in call.keywords)
        stands = name == 'Condition' and ast.unparse(others[0]) == 'False'
        if to_stderr or stands or name == 'CannotGoOnError':
            yield text


def kinds() -> Iterator[str]:
    """Yield the kinds of messages that are refused, live or in a bag."""
    for name, call in calls('.'):
        if name == 'Refused':
            yield template(call.args[0])


def said() -> set[str]:
    """Return everything that the programs can say, set-up included."""
    files = [path.read_text(encoding='utf-8') for path in PACKAGE.rglob('*.py')]
    texts = {template(node) for text in files for node in ast.walk(ast.parse(text))}
    shell = (ROOT / 'scripts' / 'setup').read_text(encoding='utf-8')
    for pair in re.findall(r'"([^"\n]+)"|\'([^\'\n]+)\'', shell):
        texts |= {re.sub(r'\$\(.*?\)|\$\w+|\$\{.*?\}', GAP, text) for text in pair}
    return {text for text in texts if len(text) >= SHORTEST}


def entries() -> list[str]:
    """Return what stands in backquotes in the first column of the page's tables."""
    rows = re.findall(r'^\| (`.*?`) \| ', PAGE, re.M)
    return [entry for row in rows for entry in re.findall(r'`(.*?)`', row)]


def explain(entry: str) -> re.Pattern[str]:
    """Return what fits the texts that an entry stands for: its parts come in this order."""
    return re.compile('.*'.join(map(re.escape, entry.split(GAP))), re.S)


def test_every_warning_is_explained() -> None:
    texts = {text for text in warnings() if text.strip(f'{GAP}: ')}  # others hand one on
    assert len(texts) > 20
    patterns = [explain(entry) for entry in entries()]
    missing = {text for text in texts if not any(each.match(text) for each in patterns)}
    assert not missing, f'doc/troubleshooting.md lacks {missing}'


def test_every_kind_of_refusal_is_explained() -> None:
    missing = set(kinds()) - set(entries())
    assert not missing, f'doc/troubleshooting.md lacks {missing}'


def test_no_message_is_explained_twice() -> None:
    texts, by_texts = said(), defaultdict(list)
    for entry in entries():
        by_texts[frozenset(filter(explain(entry).match, texts))].append(entry)
    doubles = [same for same in by_texts.values() if len(same) > 1]
    assert not doubles, f'doc/troubleshooting.md has twice {doubles}'


def test_every_explained_message_can_be_said() -> None:
    assert all(len(entry.strip(GAP)) >= SHORTEST for entry in entries())
    texts = said()
    unsaid = [entry for entry in entries() if not any(map(explain(entry).match, texts))]
    assert not unsaid, f'nothing says {unsaid}'
