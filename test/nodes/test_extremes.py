# SPDX-License-Identifier: Apache-2.0
"""The least and the largest values that each numeric parameter takes, without processes."""

from __future__ import annotations

from collections.abc import Iterator
import math

from herding_ros.control.lockstep_pilot import LockstepPilot
from herding_ros.control.parameters import Control, Horizon, Mapping
from herding_ros.control.pilot import Observed
from herding_ros.control.real_time_pilot import RealTimePilot
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.parameters import Parameters
from herding_ros.model.potentials import Harmonic, Mollified, Morse, PowerLaw
from herding_ros.model.scenario import initial_herd
from herding_ros.model.simulation import World
from herding_ros.nodes import messages
from herding_ros.nodes.controller import ControllerSettings
from herding_ros.nodes.sim import SimSettings
from herding_ros.nodes.simulated_run import SimulatedRun
import numpy as np

SIZES = {'sheep', 'substeps', 'most_sheep', 'coarse.markers', 'mapping.paths', 'horizon.substeps'}
"""Large values are no more than large; they take minutes or all memory."""

CROWDS = [
    Crowd(),
    Crowd(sheep=PowerLaw()),
    Crowd(dog=PowerLaw()),
    Crowd(Mollified(Morse())),
    Crowd(sheep=Harmonic(), order=1),
    Crowd(dog=Harmonic(), order=1),
]
"""Forces of sheep or of dogs by a table: a planner with both would be compiled for this alone."""
TABLES = Crowd(PowerLaw(), Harmonic())
SIM = [SimSettings(), World(sheep=3, dogs=2)]
CONTROL = Control(horizon=Horizon(length=0.4, accepted=0.2), mapping=Mapping(paths=4))
CONTROLLER = [ControllerSettings(dogs=2), CONTROL]
HERD = initial_herd(3, 2, np.array([0.5, 0.5]), np.random.default_rng(0))


def extremes(sets: list[Parameters]) -> Iterator[tuple[str, list[Parameters]]]:
    """Yield the sets with one number at a bound, or at the least number beside 0."""
    for i, each in enumerate(sets):
        for name, value, field in each.walk():
            low, high = field.metadata['low'], field.metadata['high']
            if low is None or name in SIZES:
                continue
            values = [low, 2**63 - 1 if high is None else high]
            values += [5e-324] if low == 0.0 and type(value) is float else []
            for extreme in values:
                given = (extreme,) * len(value) if isinstance(value, tuple) else extreme
                try:
                    changed = each.with_values({name: given})
                except ValueError:  # does not go together with the others
                    continue
                yield f'{name} = {given!r}', [*sets[:i], changed, *sets[i + 1 :]]


def situations(sets: list[Parameters]) -> Iterator[tuple[str, list[Parameters]]]:
    """Yield the sets and a crowd, with one number of all at a bound."""
    yield from extremes([*sets, CROWDS[0]])
    for crowd in CROWDS[1:]:
        for what, (changed,) in extremes([crowd]):
            yield what, [*sets, changed]


def test_every_number_has_a_range() -> None:
    for each in [*SIM, *CONTROLLER, *CROWDS]:
        for name, value, field in each.walk():
            if type(value) in (float, tuple):
                bounds = field.metadata['low'], field.metadata['high']
                assert all(map(math.isfinite, bounds)), name


def test_the_sim_survives_every_value() -> None:
    for what, (settings, world, crowd) in [*situations(SIM), ('two tables', [*SIM, TABLES])]:
        run = SimulatedRun(crowd, world, np.array(settings.goal), False, settings.time_limit)
        for _ in range(4):
            if not run.stands:
                run.advance(np.full((world.dogs, 2), 0.02))
            observed = run.simulation.observe()
            assert np.isfinite(observed.state.x).all(), what
            messages.stamp_of(run.now)


def test_the_controller_survives_every_value() -> None:
    for what, (settings, control, crowd) in situations(CONTROLLER):
        planner = RecedingHorizon(crowd, control, np.array(settings.goal), settings.seed)
        period = control.horizon.control_period
        pilot = LockstepPilot(planner, 2)
        for k in range(2):
            decision = pilot.decide(Observed.complete(k * period, HERD))
            assert np.isfinite(decision.command).all(), what
            assert (decision.error is not None) == (pilot.plans_failed > k), what
        try:
            later = RealTimePilot(planner, 2, settings, lambda: 0.0, lambda work: work())
        except ValueError:
            continue
        for k in range(2):
            command = later.decide(k * period, Observed.complete(k * period, HERD)).command
            assert command is None or np.isfinite(command).all(), what
