"""Section 6.3: the centre of a symmetric herd stays at the destination."""

from __future__ import annotations

from pathlib import Path

from .experiments.symmetry import MOTIONS
from .markdown import table
from .statistics import significant
from .study import Goal, Options, Results, Row, Section
from .task import Task

DESCRIPTION = 'section 6.3: symmetric herds without friction and noise keep their centre'

_BOUND = 1e-12
_HERDS = ((0, 1), (5, 1), (10, 2), (15, 3))
"""Pairs of sheep (0: one sheep) and pairs of dogs."""
_MOTIONS = {
    'stand': 'dogs stand',
    'breathe': 'pairs of dogs run to and fro on their diameters',
    'circle': 'pairs of dogs run round the goal',
    'both': 'both',
}
_HORIZON, _LONG = 20.0, 60.0
"""A window of the paper, and a time after which round-off has grown [s]."""


def tasks(options: Options) -> list[Task]:
    """Return the herds, each with each motion of its dogs."""
    return [
        Task(
            'symmetry',
            {
                'pairs': pairs,
                'dog_pairs': dog_pairs,
                'motion': motion,
                'duration': duration,
                'dt': 0.01,
                'seed': seed,
            },
            cost=0.02,
        )
        for pairs, dog_pairs in (_HERDS[:2] if options.quick else _HERDS)
        for motion in MOTIONS
        for duration in (_HORIZON, _LONG)
        for seed in options.seed_range(20)
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the table; there is nothing to see in a picture."""
    found = results.of('symmetry', duration=_HORIZON)
    largest = max(found.values('drift'), default=None)
    measured = '–' if largest is None else f'{largest:.1e} m'
    rows = []
    for pairs, dog_pairs in _HERDS:
        for motion, words in _MOTIONS.items():
            short, long = (
                results.of(
                    'symmetry', pairs=pairs, dog_pairs=dog_pairs, motion=motion, duration=duration
                )
                for duration in (_HORIZON, _LONG)
            )
            if len(short) and len(long):
                rows.append(
                    (
                        f'{2 * pairs or 1}',
                        f'{2 * dog_pairs}',
                        words,
                        f'{max(short.values("drift")):.1e}',
                        significant(max(short.values('moved'))),
                        f'{max(long.values("drift")):.1e}',
                    )
                )
    head = (
        'sheep', 'dogs', 'motion', 'drift of the centre in 20 s, at most [m]',
        'way of a sheep, at most [m]', 'drift in 60 s [m]',
    )  # fmt: skip
    reached = None if largest is None else largest <= _BOUND
    return Section(
        {'seeds': str(len(results.parameter('seed'))), 'drifts': table(head, rows)},
        [Row('§6.3, symmetric herds', 'stable (proof)', measured, 'drift of the centre in 20 s')],
        [Goal('Symmetric herds: drift of the centre in 20 s', '≤ 1e-12 m', measured, reached)],
    )
