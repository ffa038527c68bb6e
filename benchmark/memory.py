# SPDX-License-Identifier: Apache-2.0
"""Peak memory of one case in a process of its own: `python -m benchmark.memory JAX 30 5`."""

from __future__ import annotations

import argparse
from importlib import import_module
import json
from pathlib import Path
import subprocess
import sys

from benchmark.problem import ENSEMBLE_STEPS, PATHS, Problem, STEPS

_GRADIENTS = {'JAX': 'benchmark.peers.jax_adjoint', 'CasADi': 'benchmark.peers.casadi_adjoint'}
IMPLEMENTATIONS = ('ours', *_GRADIENTS, 'ours, ensemble', 'NumPy, ensemble')


def resident(key: str) -> float:
    """Resident memory of this process [MiB]: VmRSS, now, or VmHWM, at most.

    Not ru_maxrss: that one also counts what the parent had when it started this process.
    """
    lines = Path('/proc/self/status').read_text(encoding='ascii').splitlines()
    fields = dict(line.split(':', 1) for line in lines)
    return int(fields[key].split()[0]) / 1024.0


def measure(implementation: str, sheep: int, dogs: int, steps: int) -> dict[str, float]:
    """Return resident memory [MiB] after the imports, and at most."""
    problem = Problem(sheep, dogs, steps)
    if implementation in _GRADIENTS:
        peer = import_module(_GRADIENTS[implementation])
        before = resident('VmRSS')
        peer.value_and_gradient(problem)()
    elif implementation == 'ours':
        before = resident('VmRSS')
        problem.value_and_gradient()
    else:
        from benchmark.peers.numpy_ensemble import mean_centre

        before = resident('VmRSS')
        noise = problem.noise(PATHS)
        if implementation == 'ours, ensemble':
            problem.mean_centre(noise)
        else:
            mean_centre(problem, problem.noise_array(noise))
    return {'before': before, 'peak': resident('VmHWM')}


def in_own_process(implementation: str, sheep: int, dogs: int, steps: int) -> dict[str, float]:
    """Return `measure` of a fresh process."""
    case = [implementation, str(sheep), str(dogs), '--steps', str(steps)]
    command = [sys.executable, '-m', 'benchmark.memory', *case]
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
    return json.loads(done.stdout)


def main() -> None:
    """Print the memory of the case on the command line as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('implementation', choices=IMPLEMENTATIONS)
    parser.add_argument('sheep', type=int)
    parser.add_argument('dogs', type=int)
    parser.add_argument('--steps', type=int, help='time steps; default: those of the benchmark')
    given = parser.parse_args()
    usual = ENSEMBLE_STEPS if 'ensemble' in given.implementation else STEPS
    steps = given.steps or usual[given.sheep]
    print(json.dumps(measure(given.implementation, given.sheep, given.dogs, steps)))


if __name__ == '__main__':
    main()
