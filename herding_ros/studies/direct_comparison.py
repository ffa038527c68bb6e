"""What mappings get of the error reduction of direct optimisation, and at what cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .markdown import table
from .pictures import COLOURS, GREY, new, save
from .statistics import Mean

Pair = tuple[dict[str, Any], dict[str, Any]]
"""Results of a window and of direct optimisation, of the same flock on the same paths."""

SENSITIVITY = 81
"""Cost of a sensitivity: a rollout, and sweeps for two coordinates every 0.5 s of 20 s."""


def cost_of_mapping(window: dict[str, Any], paths: int, once: bool) -> float:
    """Return rollouts and sweeps of a mapping; `once`: with one sensitivity for all."""
    calls = window['calls']
    sensitivities = 1 if once else calls['extraction']
    return float(calls['fine'] * paths + calls['extraction'] + sensitivities * SENSITIVITY)


def cost_of_direct(direct: dict[str, Any], paths: int) -> float:
    """Return rollouts and sweeps of direct optimisation."""
    return 2.0 * paths * len(direct['errors'])


def shares(pairs: Sequence[Pair]) -> Mean:
    """Return the mean share of direct optimisation's error reduction that a mapping gets."""
    return Mean.of(
        [
            (window['before'] - window['after']) / (window['before'] - direct['after'])
            for window, direct in pairs
            if window['before'] > direct['after']
        ]
    )


def unseen_shares(pairs: Sequence[Pair]) -> Mean:
    """Return the same on noise that neither has seen."""
    values = []
    for window, direct in pairs:
        possible = window['judged_before'] - direct['judged']['error']
        if possible > 0.0:
            values.append((window['judged_before'] - window['judged_after']) / possible)
    return Mean.of(values)


def cost_shares(pairs: Sequence[Pair], paths: int) -> Mean:
    """Return the mean cost of output mapping as a share of that of direct optimisation."""
    return Mean.of(
        [
            cost_of_mapping(window, paths, once=True) / cost_of_direct(direct, paths)
            for window, direct in pairs
        ]
    )


def comparison(pairs: Mapping[float, Sequence[Pair]], paths: int) -> str:
    """Return the table of output mapping against direct optimisation, by sigma."""
    rows = []
    for sigma, each in pairs.items():
        needed = [_cost_to_reach(window['after'], direct, paths) for window, direct in each]
        reached = [cost for cost in needed if cost is not None]
        never = f'; never in {needed.count(None)} of {len(each)}' if None in needed else ''
        rows.append(
            (
                f'{sigma:g}',
                str(Mean.of([window['before'] for window, _ in each])),
                str(Mean.of([direct['after'] for _, direct in each])),
                str(Mean.of([window['after'] for window, _ in each])),
                str(Mean.of([direct['judged']['error'] for _, direct in each])),
                str(Mean.of([window['judged_after'] for window, _ in each])),
                str(shares(each)),
                str(unseen_shares(each)),
                str(Mean.of([cost_of_mapping(window, paths, once=True) for window, _ in each])),
                str(Mean.of([cost_of_direct(direct, paths) for _, direct in each])),
                f'{Mean.of(reached)}{never}',
            )
        )
    head = (
        'σ', 'before', 'direct, seen', 'mapping, seen', 'direct, unseen', 'mapping, unseen',
        'share of the reduction, seen', 'the same, unseen', 'cost of the mapping',
        'cost of direct', "direct's cost until it is as good as the mapping",
    )  # fmt: skip
    return table(head, rows)


def _cost_to_reach(error: float, direct: dict[str, Any], paths: int) -> float | None:
    """Return what direct optimisation spends until its error is that small, or None."""
    gradients = next((k for k, each in enumerate(direct['errors'], 1) if each <= error), None)
    return None if gradients is None else 2.0 * paths * gradients


def draw_costs(
    pairs: Mapping[float, Sequence[Pair]],
    aggressive: Mapping[float, Sequence[dict[str, Any]]],
    paths: int,
    path: Path,
) -> str:
    """Draw relative errors over what was spent, and return the link."""
    figure, ((axes,),) = new(1, 1, width=6.0, height=3.6)
    for colour, (sigma, each) in zip(COLOURS, pairs.items(), strict=False):
        if each:
            curves = _best_so_far([direct for _, direct in each])
            cost = 2.0 * paths * np.arange(1, len(curves) + 1)
            axes.plot(cost, curves, color=colour, label=f'σ = {sigma:g}')
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
    return save(figure, path)


def _best_so_far(directs: Sequence[dict[str, Any]]) -> Any:
    """Return the mean relative error after each gradient; who has ended stays where it is."""
    length = max(len(direct['errors']) for direct in directs)
    curves = []
    for direct in directs:
        best = np.minimum.accumulate(direct['errors']) / direct['before']
        curves.append(np.pad(best, (0, length - len(best)), mode='edge'))
    return np.mean(curves, axis=0)
