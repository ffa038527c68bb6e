# SPDX-License-Identifier: Apache-2.0
"""Herds a randomly moving crowd with a few robots by space-mapping receding-horizon control.

The public names below are imported when they are first used, so that programs which need no
model (the recorder, reports) load no compiled code.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from .control.closed_loop import closed_loop, ClosedLoopRun, Plant, play, Policy, steer
    from .control.costs.cost import Cost, Derivatives
    from .control.parameters import Control, Horizon, Mapping, PAPER, Weights
    from .control.plan import Plan
    from .control.receding_horizon import RecedingHorizon
    from .model.crowd import Crowd, CROWDS
    from .model.flock import distance, spread
    from .model.noise_field import NoiseField
    from .model.potentials import Morse
    from .model.simulation import Observation, Simulation, World
    from .model.state import HerdState, Trajectory

__version__ = '0.2.0'

_HOMES = {
    'control.closed_loop': ('ClosedLoopRun', 'Plant', 'Policy', 'closed_loop', 'play', 'steer'),
    'control.costs.cost': ('Cost', 'Derivatives'),
    'control.parameters': ('Control', 'Horizon', 'Mapping', 'PAPER', 'Weights'),
    'control.plan': ('Plan',),
    'control.receding_horizon': ('RecedingHorizon',),
    'model.crowd': ('CROWDS', 'Crowd'),
    'model.flock': ('distance', 'spread'),
    'model.noise_field': ('NoiseField',),
    'model.potentials': ('Morse',),
    'model.simulation': ('Observation', 'Simulation', 'World'),
    'model.state': ('HerdState', 'Trajectory'),
}
_MODULES = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    'CROWDS',
    'PAPER',
    'ClosedLoopRun',
    'Control',
    'Cost',
    'Crowd',
    'Derivatives',
    'HerdState',
    'Horizon',
    'Mapping',
    'Morse',
    'NoiseField',
    'Observation',
    'Plan',
    'Plant',
    'Policy',
    'RecedingHorizon',
    'Simulation',
    'Trajectory',
    'Weights',
    'World',
    'closed_loop',
    'distance',
    'play',
    'spread',
    'steer',
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'.{_MODULES[name]}', __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
