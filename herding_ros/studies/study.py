"""What a study is: which tasks it wants, and what it makes of their results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from .store import Result
from .task import Task


@dataclass(frozen=True)
class Options:
    """What a user can ask for: fewer or more seeds and Monte Carlo paths, or a smoke test."""

    seeds: int | None = None
    paths: int | None = None
    quick: bool = False

    def seed_range(self, usual: int) -> range:
        """Return the seeds of a study that usually takes so many."""
        return range(self.seeds or (1 if self.quick else usual))

    def path_number(self, usual: int) -> int:
        """Return the Monte Carlo paths of a study that usually takes so many."""
        return self.paths or (8 if self.quick else usual)


@dataclass(frozen=True)
class Results:
    """Tasks of a study with their results; those that are missing are not in it."""

    entries: Sequence[tuple[Task, Result]]

    def of(self, kind: str, **parameters: Any) -> Results:
        """Return those of a kind whose parameters have these values."""
        return self.where(
            lambda task: (
                task.kind == kind
                and all(task.parameters.get(key) == parameters[key] for key in parameters)
            )
        )

    def where(self, wanted: Callable[[Task], bool]) -> Results:
        """Return those whose task is wanted."""
        return Results([(task, result) for task, result in self.entries if wanted(task)])

    def by_seed(self) -> dict[int, Result]:
        """Return the results by the seeds of their tasks."""
        return {task.parameters['seed']: result for task, result in self.entries}

    def values(self, *path: str) -> list[Any]:
        """Return the value under this path of keys in each result, leaving out None."""
        found = []
        for _, result in self.entries:
            value: Any = result
            for key in path:
                value = None if value is None else value[key]
            if value is not None:
                found.append(value)
        return found

    def parameter(self, name: str) -> list[Any]:
        """Return the different values of a parameter, in order."""
        found = {task.parameters[name] for task, _ in self.entries if name in task.parameters}
        return sorted(found)

    def __len__(self) -> int:
        """Return their number."""
        return len(self.entries)

    def __iter__(self) -> Iterator[Result]:
        """Go through the results."""
        return (result for _, result in self.entries)


@dataclass(frozen=True)
class Row:
    """A figure or table of the paper: its number, ours with an error, and a remark."""

    what: str
    paper: str
    ours: str
    remark: str = ''


@dataclass(frozen=True)
class Goal:
    """What is aimed at, what came out, and whether that is enough (None: not known)."""

    text: str
    bound: str
    measured: str
    reached: bool | None


@dataclass(frozen=True)
class Section:
    """What a study found: the values for the placeholders of its page, rows and goals.

    The page is pages/<study>.md. Values are Markdown; those of pictures are their links.
    """

    values: Mapping[str, str]
    rows: Sequence[Row] = ()
    goals: Sequence[Goal] = ()


class Study(Protocol):
    """A module of this package that can be run under its name."""

    DESCRIPTION: str
    """One line."""

    def tasks(self, options: Options) -> list[Task]:
        """Return all that has to be computed."""

    def draw(self, results: Results, figures: Path) -> Section:
        """Draw figures into a folder and make tables, from results that may be incomplete."""
