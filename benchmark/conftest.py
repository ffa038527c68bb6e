# SPDX-License-Identifier: Apache-2.0
"""Shared by all benchmarks: sizes, and timing two functions in turns."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from benchmark import machine
from herding_ros.control.parameters import Control
import numpy as np
import pytest

_SECONDS = 3.0
"""A comparison is repeated for about this long, but within the limits that follow."""
_ROUNDS = (5, 25)
_QUICK = {
    'sheep': 10,
    'flock_size': 3000,
    'dogs': 5,
    'seed': 0,
    'implementation': 'ours',
    'window': 'second',
    'sigma': 0.01,
    'control': Control(),
}
"""Where a benchmark is parametrised by these, --quick runs only these."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --quick."""
    parser.addoption('--quick', action='store_true', help='tiny cases, as a test')


def pytest_configure() -> None:
    """Describe the machine while it is still idle."""
    machine.describe()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep few cases with --quick."""

    def is_quick(item: pytest.Item) -> bool:
        case = item.callspec.params if hasattr(item, 'callspec') else {}
        return all(case.get(key, value) == value for key, value in _QUICK.items())

    if config.getoption('--quick'):
        config.hook.pytest_deselected(items=[item for item in items if not is_quick(item)])
        items[:] = filter(is_quick, items)


def pytest_benchmark_update_machine_info(config: pytest.Config, machine_info: dict) -> None:
    """Replace the description by pytest-benchmark, which names the host."""
    machine_info.clear()
    machine_info.update(machine.describe())


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """Print the figure of a benchmark where pytest would print PASSED."""
    figure = dict(getattr(report, 'user_properties', ())).get('figure')
    if report.when != 'call' or not report.passed or figure is None:
        return None
    return 'passed', '.', f'{figure}'


@pytest.fixture(scope='session')
def quick(pytestconfig: pytest.Config) -> bool:
    """Whether only tiny cases shall run."""
    return pytestconfig.getoption('--quick')


@pytest.fixture
def record(benchmark: Any, record_property: Any) -> Callable[..., None]:
    """Return a function that keeps facts for the report: subject, figure, and more."""

    def keep(what: str, figure: str, **facts: Any) -> None:
        benchmark.extra_info.update(what=what, **facts)
        record_property('figure', figure)

    return keep


@pytest.fixture
def compare(benchmark: Any, record: Callable[..., None], quick: bool) -> Callable[..., None]:
    """Return a function that times ours and a peer in turns and records the ratios.

    A, B, A, B, ...: a ratio is that of two neighbours, so that other load on the machine
    affects both.
    """

    def run(
        what: str,
        ours: Callable[[], Any],
        peer: Callable[[], Any],
        /,
        unit: str = 'x',
        **facts: Any,
    ) -> None:
        started = time.perf_counter()
        ours()
        peer()
        pair = time.perf_counter() - started
        rounds = 2 if quick else int(np.clip(_SECONDS / pair, *_ROUNDS))
        of_peer: list[float] = []

        def time_peer() -> None:
            started = time.perf_counter()
            peer()
            of_peer.append(time.perf_counter() - started)

        benchmark.pedantic(ours, setup=time_peer, rounds=rounds)
        of_ours = list(benchmark.stats.stats.data)
        ratios = np.divide(of_peer, of_ours)
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        record(
            what,
            f'{middle:.3g} {unit} ({low:.3g} to {high:.3g})',
            seconds=of_ours,
            peer_seconds=of_peer,
            ratios=ratios.tolist(),
            **facts,
        )

    return run


@pytest.fixture(autouse=True)
def _in_scratch(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in a scratch folder: CasADi writes its C into the working directory."""
    monkeypatch.chdir(tmp_path)
