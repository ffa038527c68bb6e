# SPDX-License-Identifier: Apache-2.0
"""What a study is: the tasks that it computes, and what it makes of their results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Protocol

from herding_ros.report.markdown import Goal
from herding_ros.report.statistics import Mean

from .store import Result
from .task import Task


@dataclass(frozen=True)
class Options:
    """Options of the command line: main numbers of studies (None: the usual ones), a smoke test.

    seeds, paths: how many; sigma: strengths of the noise [m/s^1.5]; data: file of recordings.
    """

    seeds: int | None = None
    paths: int | None = None
    quick: bool = False
    sigma: tuple[float, ...] | None = None
    data: Path | None = None
    _taken: set[str] = field(default_factory=set, init=False, repr=False, compare=False)

    def seed_range(self, usual: int) -> range:
        """Return the seeds of a study that has `usual` of them by default."""
        self._taken.add('seeds')
        return range(self.seeds or (1 if self.quick else usual))

    def path_number(self, usual: int) -> int:
        """Return the number of Monte Carlo paths of a study that has `usual` by default."""
        self._taken.add('paths')
        return self.paths or (8 if self.quick else usual)

    def sigma_values(self, usual: Sequence[float], quick: Sequence[float]) -> Sequence[float]:
        """Return the strengths of the noise of a study that varies it [m/s^1.5]."""
        self._taken.add('sigma')
        return self.sigma or (quick if self.quick else usual)

    @property
    def recordings(self) -> Path | None:
        """The file of recordings of a study that fits some; None: what is stored is all."""
        self._taken.add('data')
        return self.data

    @property
    def idle(self) -> list[str]:
        """Names of what was given and no study has asked for."""
        given = ('seeds', 'paths', 'sigma', 'data')
        return [name for name in given if getattr(self, name) and name not in self._taken]


def grid(**values: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Yield every combination of values as parameters by name, the last one varying fastest."""
    for each in product(*values.values()):
        yield dict(zip(values, each, strict=True))


def tasks_of(
    kind: str, cost: float, cases: Iterable[Mapping[str, Any]], **common: Any
) -> list[Task]:
    """Return a task for each case, whose parameters come on top of the common ones."""
    return [Task(kind, {**common, **case}, cost) for case in cases]


@dataclass(frozen=True)
class Results:
    """Tasks of a study with their results; tasks without a result are left out."""

    entries: Sequence[tuple[Task, Result]]

    def of(self, kind: str, **parameters: Any) -> Results:
        """Return those of a kind whose parameters have these values."""
        return self.where(
            lambda task: (
                task.kind == kind
                and all(task.parameters.get(key) == parameters[key] for key in parameters)
            )
        )

    def where(self, condition: Callable[[Task], bool]) -> Results:
        """Return those whose task satisfies a condition."""
        return Results([(task, result) for task, result in self.entries if condition(task)])

    def by_seed(self) -> dict[int, Result]:
        """Return the results by the seeds of their tasks."""
        return {task.parameters['seed']: result for task, result in self.entries}

    def values(self, *path: str) -> list[Any]:
        """Return the value under a path of keys in each result, leaving out None."""
        found = []
        for value in self:
            for key in path:
                value = None if value is None else value[key]
            if value is not None:
                found.append(value)
        return found

    def mean(self, *path: str) -> Mean:
        """Return the mean of `values`."""
        return Mean.of(self.values(*path))

    def ratio(self, after: str, before: str) -> Mean:
        """Return the mean of one value over another, where the latter is positive."""
        return Mean.of([each[after] / each[before] for each in self if each[before] > 0.0])

    def parameter(self, name: str) -> list[Any]:
        """Return the distinct values of a parameter, in order."""
        return sorted(
            {task.parameters[name] for task, _ in self.entries if name in task.parameters}
        )

    @property
    def seeds(self) -> str:
        """The number of seeds, for a page."""
        return str(len(self.parameter('seed')))

    def __len__(self) -> int:
        """Return their number."""
        return len(self.entries)

    def __iter__(self) -> Iterator[Any]:
        """Iterate over the results."""
        return (result for _, result in self.entries)


@dataclass(frozen=True)
class Row:
    """A figure or table of the paper: its number, ours with its uncertainty, and a remark."""

    what: str
    paper: str
    ours: object
    remark: str = ''


NOT_IN_PAPER = 'not in the paper'


@dataclass(frozen=True)
class Section:
    """Findings of a study: values for the placeholders of its page, rows and goals.

    The page is pages/<study>.md. Values are Markdown; figures are in the folder `figures`.
    """

    values: Mapping[str, str]
    rows: Sequence[Row] = ()
    goals: Sequence[Goal] = ()


class Study(Protocol):
    """A module of this package that can be run under its name."""

    TITLE: str
    """Heading of its page, or of its section of the page on the paper."""

    DESCRIPTION: str
    """One line for the help text."""

    def tasks(self, options: Options) -> list[Task]:
        """Return everything that has to be computed."""

    def draw(self, results: Results, figures: Path) -> Section:
        """Draw figures into a folder and make tables, from results that may be incomplete."""
