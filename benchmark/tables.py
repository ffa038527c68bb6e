# SPDX-License-Identifier: Apache-2.0
"""The tables of the page, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product

from benchmark.goals import GOALS, NOT_MEASURED
from benchmark.memory import IMPLEMENTATIONS
from benchmark.problem import DOGS, SHEEP
from benchmark.results import Entry, Results
from herding_ros.report import markdown
from herding_ros.report.statistics import Quartiles, significant
import numpy as np

table = partial(markdown.table, nothing=NOT_MEASURED)


def median(seconds: Sequence[float], per: float) -> float:
    """Return the median in the unit `per` [s]."""
    return float(np.median(seconds)) / per


def by_case(results: Results, what: str) -> list[Entry]:
    """Return the entries, few sheep and dogs first."""
    return sorted(results.of(what), key=lambda entry: (entry['sheep'], entry['dogs']))


def goals(results: Results) -> str:
    """Return the first table: the goals, and whether they are reached."""
    return markdown.goals(goal.judge(results) for goal in GOALS)


def machine(results: Results) -> str:
    """Return the machine on which the figures were taken."""
    return table({'machine': key, 'value': value} for key, value in results.machine.items())


def gradients(results: Results) -> str:
    """Return times of value and gradient, ours and the peers'."""
    return table(
        {
            'N': entry['sheep'],
            'M': entry['dogs'],
            'steps': entry['steps'],
            'peer': entry['peer'],
            'ours [µs/step]': median(entry['seconds'], 1e-6 * entry['steps']),
            'peer [µs/step]': median(entry['peer_seconds'], 1e-6 * entry['steps']),
            'peer / ours': Quartiles.of(entry['ratios']),
        }
        for entry in by_case(results, 'value and gradient')
    )


def roofline(results: Results) -> str:
    """Return how near to the roof the kernels are."""

    def rate(entry: Entry, what: str) -> str:
        return f'{1e-6 * entry[what] / np.median(entry["seconds"]):.0f}'

    return table(
        {
            'kernel': entry['kernel'],
            'N': entry['sheep'],
            'interactions [10⁶/s]': rate(entry, 'interactions'),
            'evaluations [10⁶/s]': rate(entry, 'evaluations'),
            'of the roof': Quartiles.of(entry['ratios']),
        }
        for entry in results.of('roofline')
    )


def ensemble(results: Results) -> str:
    """Return times of an ensemble, ours and NumPy's."""
    return table(
        {
            'N': entry['sheep'],
            'M': entry['dogs'],
            'steps': entry['steps'],
            'ours [ms]': median(entry['seconds'], 1e-3),
            'NumPy [ms]': median(entry['peer_seconds'], 1e-3),
            'NumPy / ours': Quartiles.of(entry['ratios']),
        }
        for entry in by_case(results, 'ensemble')
    )


def optimiser(results: Results) -> str:
    """Return time and evaluations until the same objective is reached."""
    return table(
        {
            'start': entry['start'],
            'seed': entry['seed'],
            'PQN [ms]': median(entry['seconds'], 1e-3),
            'evaluations of PQN': entry['calls'],
            'L-BFGS-B [ms]': median(entry['peer_seconds'], 1e-3),
            'evaluations of L-BFGS-B': entry['peer_calls'],
            'SciPy / ours': Quartiles.of(entry['ratios']),
        }
        for entry in results.of('optimiser')
    )


def whole_solves(results: Results) -> str:
    """Return the time of whole solves, and how far from the target they end."""

    def excess(share: float) -> str:
        return f'{share:+.1e}'

    return table(
        {
            'peer': entry['peer'],
            'seed': entry['seed'],
            'ours [ms]': median(entry['seconds'], 1e-3),
            'above the target': excess(entry['excess']),
            'peer [ms]': median(entry['peer_seconds'], 1e-3),
            'peer above the target': excess(entry['peer_excess']),
            'peer / ours': f'{"" if entry["reached"] else "> "}{Quartiles.of(entry["ratios"])}',
        }
        for entry in results.of('whole solve')
    )


def feedback(results: Results) -> str:
    """Return what a feedback takes."""
    return table(
        {
            'seed': entry['seed'],
            'value with gradient [ms]': median(entry['seconds'], 1e-3),
            'feedback [ms]': median(entry['peer_seconds'], 1e-3),
            'evaluations': entry['calls'],
            'values with gradient': Quartiles.of(entry['ratios']),
        }
        for entry in results.of('feedback')
    )


def walls(results: Results) -> str:
    """Return what planning among walls takes."""
    return table(
        {
            'seed': entry['seed'],
            'what': entry['kind'],
            'free [ms]': median(entry['seconds'], 1e-3),
            'among walls [ms]': median(entry['peer_seconds'], 1e-3),
            'among walls / free': Quartiles.of(entry['ratios']),
        }
        for entry in results.of('planning among walls')
    )


def replan(results: Results) -> str:
    """Return the time of a window, and of its phases."""

    def row(entry: Entry) -> dict[str, object]:
        seconds, phases, corrections = entry['seconds'], entry['phases'], entry['corrections']
        return {
            'σ': str(entry['sigma']),
            'window': entry['window'],
            'corrections': (
                'always 3' if entry['thorough'] else f'{min(corrections)} to {max(corrections)}'
            ),
            'total [ms]': Quartiles.of(1e3 * np.array(seconds)),
            'longest [ms]': 1e3 * max(seconds),
            'coarse solve [ms]': median(phases['coarse'], 1e-3),
            'Monte Carlo [ms]': median(phases['fine'], 1e-3),
            'extraction [ms]': median(phases['extraction'], 1e-3),
            'evaluations': f'{np.median(entry["calls"]):.0f}',
            'of the time played': f'{100.0 * np.median(seconds) / entry["accepted"]:.1f} %',
        }

    return table(map(row, results.of('replan')))


def _mesh(entry: Entry) -> dict[str, object]:
    return {'reach [m]': float(entry['reach']), 'mesh': '{} × {}'.format(*entry['points'])}


def forces(results: Results) -> str:
    """Return times and errors of the forces in big flocks, ours on all cores."""
    return table(
        {
            'N': entry['sheep'],
            'error': f'{entry["error"]:.1e}',
            **_mesh(entry),
            'one evaluation [ms]': median(entry['seconds'], 1e-3),
        }
        for entry in results.of('force')
    )


def direct_forces(results: Results) -> str:
    """Return times of the forces against the direct sum's, one thread each."""
    return table(
        {
            'N': entry['sheep'],
            'accuracy': f'{entry["accuracy"]:g}',
            'error': f'{entry["error"]:.1e}',
            **_mesh(entry),
            'ours [ms]': median(entry['seconds'], 1e-3),
            'direct [ms]': median(entry['peer_seconds'], 1e-3),
            'direct / ours': Quartiles.of(entry['ratios']),
        }
        for entry in results.of('force against direct')
    )


def crossover(results: Results) -> str:
    """Return times of a rollout with direct sums over those with a mesh."""
    return table(
        {'N': entry['sheep'], 'direct / mesh': Quartiles.of(entry['ratios'])}
        for entry in results.of('crossover')
    )


def steps(results: Results) -> str:
    """Return the time of a step over the number of sheep."""
    return table(
        {'N': entry['sheep'], 'a step [ms]': Quartiles.of(1e3 * np.array(entry['seconds']))}
        for entry in results.of('step')
    )


def jitter(results: Results) -> str:
    """Return the deviation of the time between two commands from the control period."""
    return table(
        {
            'times real time': entry['factor'],
            'simulated s': f'{entry["simulated"]:g}',
            'control period [ms]': float(entry['period_ms']),
            'p50 [ms]': float(entry['p50_ms']),
            'p99 [ms]': float(entry['p99_ms']),
            'largest [ms]': float(entry['max_ms']),
            'plans': entry['plans'],
            'deadlines missed': entry['missed'],
        }
        for entry in results.of('jitter')
    )


def herd(results: Results) -> str:
    """Return the runs of the whole system."""
    columns = {
        'simulated [s]': 'simulated',
        'wall [s]': 'wall',
        'of it replans [s]': 'solving',
        'simulated / wall': 'factors',
        'without replans': 'without_solving',
        'with start and report [s]': 'seconds',
    }
    return table(
        {
            'N': f'{entry["herded"]:,}',
            'M': entry['dogs'],
            **{head: significant(entry[key][run]) for head, key in columns.items()},
            'largest process [MiB]': f'{entry["peak"]:.0f}',
        }
        for entry in results.of('herd')
        for run in range(len(entry['seconds']))
    )


def memory(results: Results) -> str:
    """Return the peaks of all cases."""

    def cell(**case: object) -> str:
        found = results.of('memory', **case)
        return f'{found[0]["peak"]:.0f} ({found[0]["before"]:.0f})' if found else ''

    return table(
        {'N': n, 'M': m, **cells}
        for n, m in product(SHEEP, DOGS)
        if any(
            (
                cells := {
                    name: cell(implementation=name, sheep=n, dogs=m) for name in IMPLEMENTATIONS
                }
            ).values()
        )
    )
