# SPDX-License-Identifier: Apache-2.0
"""The goals, and how they are read off the results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmark.results import Results
from herding_ros.report import markdown
from herding_ros.report.statistics import Quartiles
import numpy as np


def growth(results: Results) -> list[float]:
    """Return the exponents p of time ~ N^p, from N to ten times as many sheep."""
    return list(np.log10(results.values('ratios', 'growth', sheep=100)))


def growth_of_step(results: Results) -> list[float]:
    """Return the exponents p of time ~ N^p of a step from 1e3 to 1e6 sheep."""
    few = results.values('seconds', 'step', sheep=1000)
    many = results.values('seconds', 'step', sheep=1_000_000)
    return [float(np.log10(seconds / np.median(few))) / 3.0 for seconds in many if few]


def milliseconds(results: Results, what: str, **case: object) -> list[float]:
    """Return the times of a case [ms]."""
    return [1e3 * seconds for seconds in results.values('seconds', what, **case)]


def least_ratio(what: str, **case: object) -> Callable[[Results], list[float]]:
    """Return a function to the median ratio of the case where it is least."""

    def measured(results: Results) -> list[float]:
        medians = [float(np.median(entry['ratios'])) for entry in results.of(what, **case)]
        return [min(medians)] if medians else []

    return measured


NOT_MEASURED = 'not measured'


@dataclass(frozen=True)
class Goal:
    """A bound on the median of some measurements."""

    text: str
    bound: float
    measured: Callable[[Results], list[float]]
    unit: str = ''
    at_least: bool = True

    def judge(self, results: Results) -> markdown.Goal:
        """Return whether the results reach it."""
        bound = f'{"≥" if self.at_least else "≤"} {self.bound:g}{self.unit}'
        values = self.measured(results)
        if not values:
            return markdown.Goal(self.text, bound, NOT_MEASURED, None)
        found = Quartiles.of(values)
        over = found.median - self.bound
        reached = over >= 0.0 if self.at_least else over <= 0.0
        return markdown.Goal(self.text, bound, f'{found}{self.unit}', reached)


_Measured = Callable[[Results], list[float]]


def _values(key: str, what: str, **case: object) -> _Measured:
    return lambda results: results.values(key, what, **case)


def _ratio(what: str, **case: object) -> _Measured:
    return _values('ratios', what, sheep=30, **case)


def _milliseconds(what: str, **case: object) -> _Measured:
    return lambda results: milliseconds(results, what, **case)


GOALS = (
    Goal(
        'Value and gradient, N = 30, M = 5, 2000 steps: time of a straightforward JAX / ours',
        10.0,
        _ratio('value and gradient', peer='JAX, straightforward', dogs=5),
    ),
    Goal(
        'The same, after JAX was made as fast as we could',
        10.0,
        _ratio('value and gradient', peer='JAX', dogs=5),
    ),
    Goal(
        'The same: time of CasADi with scalars (SX) / ours',
        40.0,
        _ratio('value and gradient', peer='CasADi, scalars (SX)', dogs=5),
    ),
    Goal(
        'The same, after CasADi was made as fast as we could',
        40.0,
        _ratio('value and gradient', peer='CasADi', dogs=5),
    ),
    Goal(
        'Rollout, N = 30, M = 5: fraction of the [roof](#roof-of-the-kernels)',
        0.5,
        _ratio('roofline', kernel='rollout'),
    ),
    Goal(
        'Ensemble, N = 30, M = 5: fraction of the roof',
        0.5,
        _ratio('roofline', kernel='ensemble'),
    ),
    Goal(
        "Ensemble of 100 paths, N = 30, M = 5, 2000 steps: NumPy's time / ours",
        30.0,
        _ratio('ensemble', dogs=5),
    ),
    Goal(
        "[Optimiser](#optimiser), the least of five seeds, cold: L-BFGS-B's time / ours",
        1.3,
        least_ratio('optimiser', start='cold'),
    ),
    Goal('The same, after 1 s', 1.3, least_ratio('optimiser', start='after 1 s')),
    Goal('The same, after 10 s', 1.3, least_ratio('optimiser', start='after 10 s')),
    Goal(
        "Whole solve on both time grids, the least of five seeds, cold: L-BFGS-B's time / ours",
        1.3,
        least_ratio('whole solve', peer='L-BFGS-B'),
    ),
    Goal("The same: IPOPT's time / ours", 10.0, least_ratio('whole solve', peer='IPOPT')),
    Goal("The same: crocoddyl's time / ours", 10.0, least_ratio('whole solve', peer='DDP')),
    Goal("The same: MPPI's time / ours", 10.0, least_ratio('whole solve', peer='MPPI')),
    Goal(
        'Feedback, N = 30, M = 5, horizon 20 s, in values with gradient on its grid',
        12.0,
        _values('ratios', 'feedback'),
        at_least=False,
    ),
    Goal(
        '[Among 20 walls](#walls), with dogs apart: planning of a run / without either',
        1.5,
        _values('ratios', 'planning among walls', kind='run'),
        at_least=False,
    ),
    Goal(
        'The same, a window alone',
        1.5,
        _values('ratios', 'planning among walls', kind='window'),
        at_least=False,
    ),
    Goal(
        'The same, a feedback alone',
        1.5,
        _values('ratios', 'planning among walls', kind='feedback'),
        at_least=False,
    ),
    Goal(
        'Filter of commands, 10 dogs, 40 walls',
        1.0,
        _milliseconds('command filter'),
        ' ms',
        at_least=False,
    ),
    Goal(
        'A whole [replan](#replan), horizon 20 s',
        250.0,
        _milliseconds('replan', thorough=False, paths=100),
        ' ms',
        at_least=False,
    ),
    Goal(
        '`scripts/herd`, three processes: simulated seconds per second',
        20.0,
        _values('factors', 'herd', herded=30),
    ),
    Goal(
        '`scripts/herd --sheep 10000 --dogs 6`, replans apart: simulated seconds per second',
        1.0,
        _values('without_solving', 'herd', herded=10_000),
    ),
    Goal(
        'Page of the view, without a graphics card: time until a herd is seen',
        2.0,
        _values('until_seen', 'view', herded=30),
        ' s',
        at_least=False,
    ),
    Goal(
        'The same: pictures a second of 30 sheep',
        15.0,
        _values('rates', 'view', herded=30),
    ),
    Goal(
        'The same: pictures a second of 10⁴ sheep',
        5.0,
        _values('rates', 'view', herded=10_000),
    ),
    Goal(
        'Value and gradient from N = 100 to N = 1000, M = 5: exponent of N',
        2.0,
        growth,
        at_least=False,
    ),
    Goal(
        '[Forces](#big-flocks) on 10⁵ sheep, relative error at most 1e-4',
        100.0,
        _milliseconds('force', sheep=100_000),
        ' ms',
        at_least=False,
    ),
    Goal(
        'A step from N = 10³ to N = 10⁶: exponent of N',
        1.15,
        growth_of_step,
        at_least=False,
    ),
    Goal(
        'Forces, N = 10⁴, relative error at most 1e-6: time of the direct sum / ours',
        20.0,
        _values('ratios', 'force against direct', sheep=10_000, accuracy=1e-6),
    ),
)
