# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path
import subprocess
from typing import Any

from benchmark import report
from benchmark.memory import resident
from benchmark.peers import numpy_ensemble, scipy_lbfgsb
from benchmark.problem import Problem
from benchmark.race import Race
from benchmark.results import Results
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_numpy_has_the_same_ensemble() -> None:
    problem = Problem(sheep=4, dogs=2, steps=20)
    noise = problem.noise(paths=5)
    theirs = numpy_ensemble.mean_centre(problem, problem.noise_array(noise))
    assert theirs.shape == (21, 2)
    np.testing.assert_allclose(theirs, problem.mean_centre(noise), rtol=0, atol=1e-12)


@pytest.mark.parametrize('peer', ['jax', 'casadi'])
def test_peers_have_the_same_value_and_gradient(peer: str) -> None:
    pytest.importorskip(peer)
    module = pytest.importorskip(f'benchmark.peers.{peer}_adjoint')
    problem = Problem(sheep=4, dogs=2, steps=20)
    value, gradient = problem.value_and_gradient()
    peer_value, peer_gradient = module.value_and_gradient(problem)()
    assert peer_value == pytest.approx(value, rel=1e-12)
    np.testing.assert_allclose(peer_gradient, gradient, rtol=0, atol=1e-10 * abs(gradient).max())


def test_scipy_finds_the_nearest_velocity_within_the_disc() -> None:
    wanted = np.array([[[3.0, 4.0], [0.1, -0.2]]])

    def distance(u: np.ndarray) -> tuple[float, np.ndarray]:
        return 0.5 * float(np.square(u - wanted).sum()), (u - wanted) / 0.5

    found = scipy_lbfgsb.minimise(distance, np.zeros_like(wanted), max_speed=1.0, interval=0.5)
    np.testing.assert_allclose(found, [[[0.6, 0.8], [0.1, -0.2]]], rtol=0, atol=1e-3)


def test_scipy_begins_from_the_start() -> None:
    """But for velocities at the limit, where its map has no derivative."""
    start = np.array([[[0.3, -0.4], [0.0, 0.0], [0.6, 0.8]]])
    seen = []

    def flat(u: np.ndarray) -> tuple[float, np.ndarray]:
        seen.append(u)
        return 0.0, np.zeros_like(u)

    scipy_lbfgsb.minimise(flat, start, max_speed=1.0, interval=0.5)
    np.testing.assert_allclose(seen[0], start, rtol=0.01, atol=1e-15)
    np.testing.assert_allclose(seen[0][0, :2], start[0, :2], rtol=1e-14)


@pytest.mark.parametrize('peer', ['casadi_ipopt', 'crocoddyl_ddp', 'mppi'])
def test_peers_lower_the_same_objective(peer: str) -> None:
    library, _, _ = peer.partition('_')
    if library != peer:
        pytest.importorskip(library)
    module = pytest.importorskip(f'benchmark.peers.{peer}')
    race = Race(1, horizon=3.0)
    at_rest = race.value(race.start)
    assert race.value(race.planned()) <= race.target < at_rest
    found = module.solver(race)(20.0)
    assert found < at_rest - 0.7 * (at_rest - race.target)


def entry(what: str, **facts: Any) -> dict[str, Any]:
    return {'extra_info': {'what': what, **facts}, 'stats': {}}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    """Return the results of a benchmark that measured two things."""
    case = {'sheep': 30, 'dogs': 5, 'steps': 2000, 'difference': 1e-15}
    times = {'seconds': [0.01, 0.01, 0.01], 'peer_seconds': [0.1, 0.2, 0.3]}
    content = {
        'machine_info': {'processor': 'abacus'},
        'benchmarks': [
            entry('value and gradient', peer='JAX', ratios=[10.0, 20.0, 30.0], **case, **times),
            entry('growth', sheep=100, ratios=[1000.0], seconds=[1.0], peer_seconds=[1000.0]),
            {'extra_info': {}, 'stats': {}},
        ],
    }
    path = tmp_path / 'results.json'
    path.write_text(json.dumps(content), encoding='utf-8')
    return Results.read(path)


def test_the_page_says_what_was_reached_and_what_was_not_measured(
    results: Results, tmp_path: Path
) -> None:
    page = report.write(results, tmp_path / 'doc').read_text(encoding='utf-8')
    rows = [line for line in page.splitlines() if line.startswith('|')]
    assert any('JAX' in row and '≥ 10 | 20.0 (15.0 to 25.0) | yes |' in row for row in rows)
    assert any('≤ 2 | 3.00 (3.00 to 3.00) | **no** |' in row for row in rows)
    assert any('replan' in row and '≤ 250 ms | not measured |' in row for row in rows)
    assert any(row.startswith('| 30 | 5 | 2000 | JAX | 5.00 | 100 |') for row in rows)
    assert '| processor | abacus |' in page
    assert '$' not in page
    assert (tmp_path / 'doc' / 'performance.png').read_bytes().startswith(b'\x89PNG')


def test_the_page_keeps_what_others_wrote(results: Results, tmp_path: Path) -> None:
    path = report.write(results, tmp_path)
    once = path.read_text(encoding='utf-8')
    path.write_text(report.put(once, 'another', 'A table.'), encoding='utf-8')
    report.write(results, tmp_path)
    assert path.read_text(encoding='utf-8') == (
        f'{once}\n<!-- another: begin -->\nA table.\n<!-- another: end -->\n'
    )
    with pytest.raises(ValueError, match='not both'):
        report.put(once.replace('end', ''), report.SECTION, 'text')


def test_peak_memory_counts_what_was_there_for_a_moment() -> None:
    before = resident('VmRSS')
    np.ones(2**25)  # 256 MiB
    assert resident('VmHWM') >= before + 250.0


def test_help_shows_options_and_outputs() -> None:
    command = [str(ROOT / 'scripts' / 'benchmark'), '--help']
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stderr) == (0, '')
    assert '--quick' in done.stdout
    assert 'doc/performance.md' in done.stdout
