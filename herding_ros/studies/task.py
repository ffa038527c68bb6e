# SPDX-License-Identifier: Apache-2.0
"""A task: one computation with its parameters, and the key of its result."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from functools import cache, cached_property
import hashlib
import json
from pathlib import Path
from typing import Any

from herding_ros import __version__

_PACKAGE = Path(__file__).resolve().parents[1]
_THAT_COMPUTE = ('model', 'control', 'studies/experiments')


@dataclass(frozen=True)
class Task:
    """One call of an experiment: its name (kind) and its parameters, which JSON can hold.

    The parameters, with the seed among them, determine the result. cost: estimated time on one
    core [s], for the display of the remaining time. inputs: further arguments, which say where
    what the parameters name is found on this machine, and do not determine the result; the task
    cannot be computed if one is empty.
    """

    kind: str
    parameters: dict[str, Any]
    cost: float = field(default=1.0, compare=False)
    inputs: dict[str, str] = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        """Convert the parameters as a file does: lists for tuples."""
        object.__setattr__(self, 'parameters', json.loads(json.dumps(self.parameters)))

    @property
    def is_possible(self) -> bool:
        """Whether it is known where all inputs are."""
        return all(self.inputs.values())

    @cached_property
    def key(self) -> str:
        """A hash of kind, parameters, version and code."""
        content = [self.kind, self.parameters, __version__, code()]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


@cache
def code() -> str:
    """Return a hash of all code that computes: model, control and the experiments.

    The version does not suffice: it stays the same during development, and results of old code
    would end up in new figures. Code that only draws does not count, nor do comments, docstrings
    and layout, since recomputing takes hours.
    """
    digest = hashlib.sha256()
    for folder in _THAT_COMPUTE:
        for path in sorted((_PACKAGE / folder).rglob('*.py')):
            digest.update(path.relative_to(_PACKAGE).as_posix().encode())
            digest.update(bare(path.read_text(encoding='utf-8')).encode())
    return digest.hexdigest()[:16]


def bare(source: str) -> str:
    """Return Python source without comments, docstrings and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [each for each in node.body if not _is_text(each)] or [ast.Pass()]
    return ast.unparse(tree)


def _is_text(node: ast.stmt) -> bool:
    """Whether the statement is an unused string: a docstring, of a field too."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
