# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag hold a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import re

from .conversion import (
    CLOUD,
    COMMAND,
    COMMAND_WITHOUT_STAMP,
    DIAGNOSTICS,
    MARKERS,
    ODOMETRY,
    PATH,
    POSE,
    TRAJECTORY,
)
from .notes import Notes
from .recorded_run import Topic
from .stored import SEVERAL_TYPES

ROOT_GOAL = '/goal_pose'
"""Where most people ask for a destination, in whatever namespace the herd is."""

_MOST_NAMED = 20
"""Topics that an error names."""


@dataclass(frozen=True)
class RunTopics:
    """The topics of a run in a namespace, '' for the root.

    sheep: their states; dogs: those of each dog by its number; commands: to these dogs; goals: of
    the destination, what is in force before what was asked for; diagnostics.
    """

    namespace: str
    sheep: str
    dogs: dict[int, str]
    commands: dict[int, str]
    goals: tuple[str, ...]
    diagnostics: tuple[str, ...]
    plan: str
    path: str
    drawing: str

    @classmethod
    def choose(
        cls,
        topics: Sequence[Topic],
        namespace: str | None,
        notes: Notes,
        observed: bool = False,
    ) -> RunTopics:
        """Return those that have messages, truth before observation, or `observed` ones alone.

        Raises ValueError unless there are sheep in the namespace, or in only one if it is None.
        """
        counts = {topic.name: topic.count for topic in topics}
        prefix = _namespace(topics, namespace)

        def with_messages(what: str, missing: str) -> str | None:
            """Return the topic of the truth if it has messages, else of the observation."""
            sources = ('',) if observed else ('truth/', '')
            named = [n for s in sources if (n := f'{prefix}/{s}{what}') in counts]
            full = [name for name in named if counts[name]]
            if not full:
                notes.add(
                    f'{" and ".join(named) or f"{prefix}/{what}"} has no messages: {missing}'
                )
            elif full[0] != named[0]:
                notes.add(f'{named[0]} has no messages: {full[0]} is read')
            return full[0] if full else None

        sheep = with_messages('sheep', '')
        if sheep is None:
            raise ValueError(f'it has no observed sheep: {prefix}/sheep must have messages')
        pattern = re.compile(f'{re.escape(prefix)}(?:/truth)?/dog_(0|[1-9][0-9]{{0,5}})/odom')
        numbers = sorted({int(m[1]) for name in counts if (m := pattern.fullmatch(name))})
        dogs = {m: with_messages(f'dog_{m}/odom', f'dog {m} is left out') for m in numbers}
        present = {m: name for m, name in dogs.items() if name}
        if not present:
            notes.add(f'there are no dogs: none has messages on {prefix}/dog_<number>/odom')
        return cls(
            prefix,
            sheep,
            present,
            {m: f'{prefix}/dog_{m}/cmd_vel' for m in present},
            (f'{prefix}/herd/goal', f'{prefix}/goal_pose'),
            tuple(dict.fromkeys(('/diagnostics', f'{prefix}/diagnostics'))),
            f'{prefix}/plan',
            f'{prefix}/herd/path',
            f'{prefix}/herd/markers',
        )

    @property
    def types(self) -> dict[str, tuple[str, ...]]:
        """The types that the messages of each topic may have."""
        return {
            self.sheep: (CLOUD,),
            **dict.fromkeys(self.dogs.values(), (ODOMETRY,)),
            **dict.fromkeys(self.commands.values(), (COMMAND, COMMAND_WITHOUT_STAMP)),
            **dict.fromkeys((*self.goals, ROOT_GOAL), (POSE,)),
            **dict.fromkeys(self.diagnostics, (DIAGNOSTICS,)),
            self.plan: (TRAJECTORY,),
            self.path: (PATH,),
            self.drawing: (MARKERS,),
        }


def _namespace(topics: Sequence[Topic], given: str | None) -> str:
    """Return the namespace, '' for the root."""
    found = sorted(
        {
            match[1]
            for topic in topics
            if topic.count and topic.type in (CLOUD, SEVERAL_TYPES)
            and (match := re.fullmatch('(.*?)(?:/truth)?/sheep', topic.name))
        }
    )  # fmt: skip
    if not found:
        named = [f'{each.name} ({each.type}, {each.count})' for each in topics[:_MOST_NAMED]]
        rest = len(topics) - len(named)
        raise ValueError(
            f'it has no states: there must be messages of type {CLOUD} on truth/sheep or sheep, '
            f'in any namespace, but there is only {", ".join(named) or "nothing"}'
            f'{f" and {rest} more" if rest else ""}'
        )
    listed = ', '.join(name or '/' for name in found)
    if given is None:
        if len(found) > 1:
            raise ValueError(
                f'it has sheep in several namespaces, {listed}: choose one by --namespace'
            )
        return found[0]
    prefix = f'/{given.strip("/")}'.rstrip('/')
    if prefix not in found:
        raise ValueError(f'the namespace must be one with sheep, {listed}, got {given}')
    return prefix
