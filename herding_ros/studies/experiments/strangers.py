# SPDX-License-Identifier: Apache-2.0
"""A run on a plant that our controller is not made for, by the plant's own rule or by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from herding_ros.control.closed_loop import Plant, play, Policy, steer
from herding_ros.control.parameters import Control, Mapping
from herding_ros.control.receding_horizon import RecedingHorizon
from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Harmonic, Morse
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
import numpy as np

from . import lama
from .measures import measures, plans
from .strombom import Strombom
from .strombom_sheep import Flock, MAX_SPEED, Sheep
from .truths import NO_FORCE, OtherWorld, Truth

_NO_BODIES = {'bodies.separation': 0.0, 'bodies.ramp': 0.0}
"""Settings for the dogs of others, which are points and take any command at once."""


class Field(Plant, Protocol):
    """A plant that has a goal with a region around it."""

    @property
    def goal(self) -> Array:
        """Where the herd should be, (2,) [m]."""

    @property
    def radius(self) -> float:
        """Radius of the region around the goal in which sheep are counted [m]."""


@dataclass(frozen=True)
class Stranger:
    """A plant, the rule that is made for it, and what our controller is told.

    settings: parameters of `Control` by dotted names, to the scale of the plant.
    """

    plant: Field
    rule: Policy
    crowd: Crowd
    settings: dict[str, Any]


def targets(seed: int, **given: Any) -> Stranger:
    """Return the targets of Lama and di Bernardo in a `lama.Setting`, which our crowd can be.

    No plan is made beyond the time in which noise takes a target out of a herder's hands: over
    the length of a window it moves one by at most half a reach.
    """
    setting = lama.Setting(**given)
    length = min(round(setting.reach**2 / (8.0 * setting.diffusion), 1), 4.0)
    crowd = Crowd(
        sheep=NO_FORCE,
        dog=Harmonic(setting.repulsion, setting.reach),
        friction=1.0,
        order=1,
        noise=np.sqrt(2.0 * setting.diffusion),
    )
    settings = {
        'max_speed': setting.max_speed,
        'horizon.control_period': setting.control_period,
        'horizon.length': length,
        'horizon.accepted': 0.5 * length,
        'horizon.feedback': max(length / 16.0, 2.0 * setting.control_period),
        'mapping.standard_error': 0.05,
        **_NO_BODIES,
    }
    rule = lama.Rule(setting.radius, setting.max_speed, behind=0.5 * setting.reach)
    return Stranger(lama.Targets(setting, seed), rule, crowd, settings)


def flock(seed: int) -> Stranger:
    """Return the sheep of Strömbom et al., and the crowd of ours that is nearest to them.

    They always move at 1 m/s, ours at force / friction. So pushes are made alike at the distances
    at which they herd: of the dog, which ends at its reach here as there, at 10 m, of the others
    at 1 m; the pull of the others is the same.
    """
    plant, kind = Flock(seed), Sheep()
    n, far = len(plant.state.x), 5.0 * kind.reach
    crowd = Crowd(
        sheep=Morse(np.e * n * kind.repulsion, 1.0, kind.cohesion * far, far),
        dog=Harmonic(kind.fear / (kind.reach - 10.0), kind.reach),
        friction=1.0,
        order=1,
        noise=kind.noise / np.sqrt(2.0),
    )
    settings = {
        'max_speed': MAX_SPEED,
        'horizon.control_period': plant.control_period,
        'horizon.length': 60.0,
        'horizon.accepted': 30.0,
        'horizon.feedback': 3.0,
        'horizon.substeps': 10,
        'mapping.max_iterations': 0,  # noise is not what this model is wrong about
        **_NO_BODIES,
    }
    chance = np.random.default_rng([seed, 30_000])
    rule = Strombom(plant.goal, chance, MAX_SPEED, kind.distance, noise=kind.noise)
    return Stranger(plant, rule, crowd, settings)


def another_truth(seed: int, sheep: int, dogs: int, goal: list[float], **truth: Any) -> Stranger:
    """Return our own plant with another `Truth` than the one that the controller is told.

    It is told how many sheep may be left behind: those that ignore dogs.
    """
    world, crowd = World(sheep=sheep, dogs=dogs, seed=seed), Crowd()
    plant = OtherWorld(crowd, world, np.array(goal), Truth(**truth))
    rule = Strombom(plant.goal, np.random.default_rng([seed, 30_000]))
    allowed = {'arrival.strays': int((plant.response == 0.0).sum())}
    return Stranger(plant, rule, crowd, allowed)


_STRANGERS: dict[str, Callable[..., Stranger]] = {
    'targets': targets,
    'flock': flock,
    'truth': another_truth,
}

_INSTANTS = 100
"""Number of instants of a run at which chi is kept."""


def run(
    plant: str,
    given: dict[str, Any],
    policy: str,
    settings: dict[str, Any],
    seed: int,
    time_limit: float,
    paths: int = Mapping.paths,
) -> dict[str, Any]:
    """Herd a stranger and return the run in numbers.

    plant: 'targets', 'flock' or 'truth', given: its parameters; policy: 'rule', the one made for
    it, or 'planner', ours, whose parameters `settings` come on top of those for the plant's
    scale. chi: fraction of the sheep that are in the region around the goal, at the times t [s].
    """
    stranger = _STRANGERS[plant](seed, **given)
    field = stranger.plant
    if policy == 'rule':
        track = play(field, stranger.rule, time_limit)
    elif policy == 'planner':
        control = Control().with_values({'mapping.paths': paths, **stranger.settings, **settings})
        planner = RecedingHorizon(stranger.crowd, control, field.goal, seed)
        track = steer(field, planner, time_limit)
    else:
        raise ValueError(f"policy must be 'rule' or 'planner', got {policy!r}")
    every = max(round(time_limit / field.control_period / _INSTANTS), 1)
    inside = np.linalg.norm(track.x - field.goal, axis=-1) <= field.radius
    return {
        **measures(track, field.goal, field.control_period),
        'dogs': len(field.dog_velocities),
        't': [round(float(t), 3) for t in track.t[::every]],
        'chi': [round(float(chi), 4) for chi in inside[::every].mean(axis=1)],
        'final_chi': float(inside[-1].mean()),
        'plans': plans(track.reports),
    }
