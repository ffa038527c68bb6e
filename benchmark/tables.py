"""The tables of the page, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmark.goals import Goal, GOALS
from benchmark.memory import IMPLEMENTATIONS
from benchmark.problem import DOGS, SHEEP
from benchmark.results import Entry, Results, Spread
from herding_ros.report.statistics import significant
from herding_ros.studies import markdown

NOT_MEASURED = 'not measured'


table = partial(markdown.table, nothing=NOT_MEASURED)


def median(seconds: Sequence[float], per: float) -> str:
    """Return the median in the unit `per` [s]."""
    return significant(float(np.median(seconds)) / per)


def by_case(results: Results, what: str) -> list[Entry]:
    """Return the entries, few sheep and dogs first."""
    return sorted(results.of(what), key=lambda entry: (entry['sheep'], entry['dogs']))


def goals(results: Results) -> str:
    """Return the first table: what was aimed at, and what it came to."""

    def row(goal: Goal) -> tuple[str, ...]:
        values = goal.measured(results)
        if not values:
            return goal.text, goal.condition, NOT_MEASURED, ''
        found = Spread.of(values)
        reached = 'yes' if goal.reached(found) else '**no**'
        return goal.text, goal.condition, f'{found}{goal.unit}', reached

    return table(('', 'goal', 'measured', 'reached'), map(row, GOALS))


def machine(results: Results) -> str:
    """Return what the figures were taken on."""
    return table(('', ''), results.machine.items())


def gradients(results: Results) -> str:
    """Return times of value and gradient, ours and the peers'."""

    def row(entry: Entry) -> tuple[str, ...]:
        step = 1e-6 * entry['steps']
        return (
            str(entry['sheep']),
            str(entry['dogs']),
            str(entry['steps']),
            entry['peer'],
            median(entry['seconds'], step),
            median(entry['peer_seconds'], step),
            str(Spread.of(entry['ratios'])),
        )

    head = ('N', 'M', 'steps', 'peer', 'ours [µs/step]', 'peer [µs/step]', 'peer / ours')
    return table(head, map(row, by_case(results, 'value and gradient')))


def roofline(results: Results) -> str:
    """Return how near to the roof the kernels are."""

    def row(entry: Entry) -> tuple[str, ...]:
        million = 1e6 * np.array(entry['seconds'])
        return (
            entry['kernel'],
            str(entry['sheep']),
            f'{np.median(entry["interactions"] / million):.0f}',
            f'{np.median(entry["evaluations"] / million):.0f}',
            str(Spread.of(entry['ratios'])),
        )

    head = ('kernel', 'N', 'interactions [10⁶/s]', 'evaluations [10⁶/s]', 'of the roof')
    return table(head, map(row, results.of('roofline')))


def ensemble(results: Results) -> str:
    """Return times of an ensemble, ours and NumPy's."""

    def row(entry: Entry) -> tuple[str, ...]:
        return (
            str(entry['sheep']),
            str(entry['dogs']),
            str(entry['steps']),
            median(entry['seconds'], 1e-3),
            median(entry['peer_seconds'], 1e-3),
            str(Spread.of(entry['ratios'])),
        )

    head = ('N', 'M', 'steps', 'ours [ms]', 'NumPy [ms]', 'NumPy / ours')
    return table(head, map(row, by_case(results, 'ensemble')))


def optimiser(results: Results) -> str:
    """Return time and evaluations until the same objective is reached."""

    def row(entry: Entry) -> tuple[str, ...]:
        return (
            str(entry['seed']),
            median(entry['seconds'], 1e-3),
            str(entry['calls']),
            median(entry['peer_seconds'], 1e-3),
            str(entry['peer_calls']),
            str(Spread.of(entry['ratios'])),
        )

    head = ('seed', 'SPG [ms]', 'evaluations', 'L-BFGS-B [ms]', 'evaluations', 'SciPy / ours')
    return table(head, map(row, results.of('optimiser')))


def replan(results: Results) -> str:
    """Return the time of a window, and of its phases."""

    def row(entry: Entry) -> tuple[str, ...]:
        corrections = entry['corrections']
        return (
            str(entry['sigma']),
            entry['window'],
            'always 3' if entry['thorough'] else f'{min(corrections)} to {max(corrections)}',
            str(Spread.of(1e3 * np.array(entry['seconds']))),
            significant(1e3 * max(entry['seconds'])),
            *(median(entry['phases'][phase], 1e-3) for phase in ('coarse', 'fine', 'extraction')),
            f'{np.median(entry["calls"]):.0f}',
            f'{100.0 * np.median(entry["seconds"]) / entry["accepted"]:.1f} %',
        )

    head = (
        'σ', 'window', 'corrections', 'total [ms]', 'longest [ms]', 'coarse solve [ms]',
        'Monte Carlo [ms]', 'extraction [ms]', 'evaluations', 'of the time played',
    )  # fmt: skip
    return table(head, map(row, results.of('replan')))


def forces(results: Results) -> str:
    """Return times and errors of the forces in big flocks, ours on all cores."""

    def row(entry: Entry) -> tuple[str, ...]:
        return (
            str(entry['sheep']),
            f'{entry["error"]:.1e}',
            significant(entry['reach']),
            '{} × {}'.format(*entry['points']),
            median(entry['seconds'], 1e-3),
        )

    head = ('N', 'error', 'reach [m]', 'mesh', 'one evaluation [ms]')
    return table(head, map(row, results.of('force')))


def direct_forces(results: Results) -> str:
    """Return times of the forces against the direct sum's, one thread each."""

    def row(entry: Entry) -> tuple[str, ...]:
        return (
            str(entry['sheep']),
            f'{entry["accuracy"]:g}',
            f'{entry["error"]:.1e}',
            significant(entry['reach']),
            '{} × {}'.format(*entry['points']),
            median(entry['seconds'], 1e-3),
            median(entry['peer_seconds'], 1e-3),
            str(Spread.of(entry['ratios'])),
        )

    head = (
        'N', 'wanted', 'error', 'reach [m]', 'mesh', 'ours [ms]', 'direct [ms]', 'direct / ours',
    )  # fmt: skip
    return table(head, map(row, results.of('force against direct')))


def crossover(results: Results) -> str:
    """Return times of a rollout with direct sums over those with a plan."""

    def row(entry: Entry) -> tuple[str, ...]:
        return str(entry['sheep']), str(Spread.of(entry['ratios']))

    return table(('N', 'direct / planned'), map(row, results.of('crossover')))


def steps(results: Results) -> str:
    """Return the time of a step over the number of sheep."""

    def row(entry: Entry) -> tuple[str, ...]:
        return str(entry['sheep']), str(Spread.of(1e3 * np.array(entry['seconds'])))

    return table(('N', 'a step [ms]'), map(row, results.of('step')))


def jitter(results: Results) -> str:
    """Return how far the time between two commands is from the control period."""

    def row(entry: Entry) -> tuple[str, ...]:
        times = (entry[key] for key in ('period_ms', 'p50_ms', 'p99_ms', 'max_ms'))
        counts = (str(entry['plans']), str(entry['missed']))
        return (str(entry['factor']), f'{entry["simulated"]:g}', *map(significant, times), *counts)

    head = ('times real time', 'simulated s', 'control period [ms]', 'p50 [ms]', 'p99 [ms]')
    return table(
        (*head, 'largest [ms]', 'plans', 'deadlines missed'), map(row, results.of('jitter'))
    )


def herd(results: Results) -> str:
    """Return the runs of the whole system."""
    columns = 'simulated', 'wall', 'solving', 'factors', 'without_solving', 'seconds'
    rows = [
        (
            f'{entry["herded"]:,}', str(entry['dogs']), *map(significant, run),
            f'{entry["peak"]:.0f}',
        )
        for entry in results.of('herd')
        for run in zip(*(entry[column] for column in columns), strict=True)
    ]  # fmt: skip
    return table(
        (
            'N', 'M', 'simulated [s]', 'wall [s]', 'of it replans [s]', 'simulated / wall',
            'without replans', 'with start and report [s]', 'largest process [MiB]',
        ),
        rows,
    )  # fmt: skip


def memory(results: Results) -> str:
    """Return the peaks of all cases."""

    def cell(implementation: str, sheep: int, dogs: int) -> str:
        found = results.of('memory', implementation=implementation, sheep=sheep, dogs=dogs)
        return f'{found[0]["peak"]:.0f} ({found[0]["before"]:.0f})' if found else ''

    rows = (
        (str(n), str(m), *(cell(name, n, m) for name in IMPLEMENTATIONS))
        for n in SHEEP
        for m in DOGS
    )
    return table(('N', 'M', *IMPLEMENTATIONS), (row for row in rows if any(row[2:])))
