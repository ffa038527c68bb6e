# SPDX-License-Identifier: Apache-2.0
"""Mappings against direct optimisation: share of the error reduction, and cost.

Costs count rollouts and reverse sweeps of single paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from herding_ros.report.markdown import table
from herding_ros.report.statistics import Mean
from herding_ros.report.style import COLOURS, GREY, new, save
import numpy as np

Pair = tuple[dict[str, Any], dict[str, Any]]
"""Results of a window and of direct optimisation, of the same flock on the same paths."""

SENSITIVITY = 81
"""Cost of a sensitivity: a rollout, and sweeps for two coordinates every 0.5 s of 20 s."""


def cost_of_mapping(window: dict[str, Any], paths: int, once: bool) -> float:
    """Return the cost of a mapping; `once`: with one sensitivity for all extractions."""
    calls = window['calls']
    sensitivities = 1 if once else calls['extraction']
    return float(calls['fine'] * paths + calls['extraction'] + sensitivities * SENSITIVITY)


def cost_of_direct(gradients: int, paths: int) -> float:
    """Return the cost of so many gradients."""
    return 2.0 * paths * gradients


def shares(pairs: Sequence[Pair]) -> Mean:
    """Return the mean share of direct optimisation's error reduction that a mapping achieves."""
    return Mean.of(
        [
            (window['before'] - window['after']) / (window['before'] - direct['after'])
            for window, direct in pairs
            if window['before'] > direct['after']
        ]
    )


def unseen_shares(pairs: Sequence[Pair]) -> Mean:
    """Return the same on noise that neither has seen."""
    return Mean.of(
        [
            (window['judged_before'] - window['judged_after']) / possible
            for window, direct in pairs
            if (possible := window['judged_before'] - direct['judged']['error']) > 0.0
        ]
    )


def cost_shares(pairs: Sequence[Pair], paths: int) -> Mean:
    """Return the mean cost of output mapping relative to that of direct optimisation."""
    return Mean.of(
        [
            cost_of_mapping(window, paths, once=True)
            / cost_of_direct(len(direct['errors']), paths)
            for window, direct in pairs
        ]
    )


def comparison(pairs: Mapping[float, Sequence[Pair]], paths: int) -> str:
    """Return the table of output mapping against direct optimisation, by sigma."""
    return table({'σ': f'{sigma:g}', **_row(each, paths)} for sigma, each in pairs.items())


def _row(pairs: Sequence[Pair], paths: int) -> dict[str, object]:
    windows, directs = [window for window, _ in pairs], [direct for _, direct in pairs]
    needed = [_cost_to_reach(window['after'], direct, paths) for window, direct in pairs]
    reached = Mean.of([cost for cost in needed if cost is not None])
    never = f'; never in {needed.count(None)} of {len(pairs)}' if None in needed else ''
    return {
        'before': Mean.of([each['before'] for each in windows]),
        'direct, seen': Mean.of([each['after'] for each in directs]),
        'mapping, seen': Mean.of([each['after'] for each in windows]),
        'direct, unseen': Mean.of([each['judged']['error'] for each in directs]),
        'mapping, unseen': Mean.of([each['judged_after'] for each in windows]),
        'share of the reduction, seen': shares(pairs),
        'the same, unseen': unseen_shares(pairs),
        'cost of the mapping': Mean.of([cost_of_mapping(each, paths, True) for each in windows]),
        'cost of direct': Mean.of(
            [cost_of_direct(len(each['errors']), paths) for each in directs]
        ),
        "direct's cost until it is as good as the mapping": f'{reached}{never}',
    }


def _cost_to_reach(error: float, direct: dict[str, Any], paths: int) -> float | None:
    """Return the cost of direct optimisation until its error is that small, or None."""
    gradients = next((k for k, each in enumerate(direct['errors'], 1) if each <= error), None)
    return None if gradients is None else cost_of_direct(gradients, paths)


def draw_costs(
    pairs: Mapping[float, Sequence[Pair]],
    aggressive: Mapping[float, Sequence[dict[str, Any]]],
    paths: int,
    path: Path,
) -> None:
    """Draw relative errors over costs."""
    figure, ((axes,),) = new(1, 1, width=6.0, height=3.6)
    for colour, (sigma, each) in zip(COLOURS, pairs.items(), strict=False):
        if each:
            curve = _best_so_far([direct for _, direct in each])
            cost = cost_of_direct(1, paths) * np.arange(1, len(curve) + 1)
            axes.plot(cost, curve, color=colour, label=f'σ = {sigma:g}')
        for windows, marker, once in (
            ([window for window, _ in each], 'o', True),
            (aggressive.get(sigma, []), 's', False),
        ):
            if windows:
                ratio = Mean.of([window['after'] / window['before'] for window in windows])
                spent = np.mean([cost_of_mapping(window, paths, once) for window in windows])
                axes.errorbar(
                    spent, ratio.value, ratio.error, fmt=marker, color=colour, markersize=5,
                    capsize=2,
                )  # fmt: skip
    axes.plot([], [], 'o', color=GREY, label='output mapping')
    axes.plot([], [], 's', color=GREY, label='aggressive mapping')
    axes.set(xlabel='rollouts and sweeps of single paths', ylabel='error / error before')
    if any(pairs.values()):
        axes.set(xscale='log', yscale='log')
    axes.legend(fontsize=7, frameon=False)
    save(figure, path)


def _best_so_far(directs: Sequence[dict[str, Any]]) -> Any:
    """Return the mean relative error after each gradient; finished runs keep their last value."""
    length = max(len(direct['errors']) for direct in directs)
    curves = []
    for direct in directs:
        best = np.minimum.accumulate(direct['errors']) / direct['before']
        curves.append(np.pad(best, (0, length - len(best)), mode='edge'))
    return np.mean(curves, axis=0)
