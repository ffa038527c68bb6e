# SPDX-License-Identifier: Apache-2.0
"""Section 6.3: the centre of a symmetric herd stays at the destination."""

from __future__ import annotations

from itertools import product
from pathlib import Path

from herding_ros.report.markdown import Goal, table

from .experiments.symmetry import MOTIONS
from .study import grid, Options, Results, Row, Section
from .task import Task

TITLE = 'Symmetric herds (section 6.3)'
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
    seeds = options.seed_range(20)
    return [
        Task('symmetry', {'pairs': pairs, 'dog_pairs': dog_pairs, 'dt': 0.01, **case}, cost=0.02)
        for pairs, dog_pairs in (_HERDS[:2] if options.quick else _HERDS)
        for case in grid(motion=MOTIONS, duration=(_HORIZON, _LONG), seed=seeds)
    ]


def draw(results: Results, figures: Path) -> Section:
    """Make the table; a picture would show nothing."""
    largest = max(results.of('symmetry', duration=_HORIZON).values('drift'), default=None)
    measured = '–' if largest is None else f'{largest:.1e} m'
    rows = []
    for (pairs, dog_pairs), (motion, words) in product(_HERDS, _MOTIONS.items()):
        here = results.of('symmetry', pairs=pairs, dog_pairs=dog_pairs, motion=motion)
        short, long = (here.of('symmetry', duration=each) for each in (_HORIZON, _LONG))
        if len(short) and len(long):
            drift, later = max(short.values('drift')), max(long.values('drift'))
            rows.append(
                {
                    'sheep': 2 * pairs or 1,
                    'dogs': 2 * dog_pairs,
                    'motion': words,
                    'drift of the centre in 20 s, at most [m]': f'{drift:.1e}',
                    'displacement of a sheep, at most [m]': max(short.values('moved')),
                    'drift in 60 s [m]': f'{later:.1e}',
                }
            )
    reached = None if largest is None else largest <= _BOUND
    return Section(
        {'seeds': results.seeds, 'drifts': table(rows)},
        [Row('§6.3, symmetric herds', 'stable (proof)', measured, 'drift of the centre in 20 s')],
        [Goal('Symmetric herds: drift of the centre in 20 s', '≤ 1e-12 m', measured, reached)],
    )
