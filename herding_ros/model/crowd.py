# SPDX-License-Identifier: Apache-2.0
"""The crowd: forces between sheep, of dogs and of the world, alignment, friction, random force."""

from __future__ import annotations

from dataclasses import dataclass

from .alignment import Alignment
from .external_form import ExternalForce, NoForce
from .noise_field import NoiseField, NoiseFunction
from .parameters import Parameters, quantity
from .potentials import Harmonic, Morse, Potential


@dataclass(frozen=True)
class Crowd(Parameters):
    """How sheep move (paper, state system). The defaults are the preset `cohesive`.

    See `noise` for how noise, common_noise and noise_field make up the random force.
    """

    sheep: Potential = Morse(1.0, 1e-2, 5e-4, 2.0)
    dog: Potential = Morse(1e-2, 0.5, 5e-4, 2.0)
    friction: float = quantity(0.5, 'friction alpha of the sheep', '1/s', low=0.0)
    order: int = quantity(
        2, 'order of the motion in time; 1: without inertia, velocity is force / friction',
        low=1, high=2,
    )  # fmt: skip
    alignment: Alignment = Alignment()
    noise: float = quantity(
        0.01, 'strength sigma of the random force on each sheep', 'm/s^1.5', low=0.0, live=True
    )
    common_noise: float = quantity(
        0.0, 'share of its variance that all sheep have in common', low=0.0, high=1.0, live=True
    )
    noise_field: NoiseFunction = NoiseField()
    external: ExternalForce = NoForce()

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.order == 1 and not self.friction:
            raise ValueError(
                'Crowd.friction must be above 0 where Crowd.order is 1, got 0: without inertia '
                'sheep move at force / friction'
            )
        if self.order == 1 and self.alignment.rate:
            raise ValueError(
                'Crowd.alignment.rate must be 0 where Crowd.order is 1, got '
                f'{self.alignment.rate:g}: without inertia sheep have no velocity to align'
            )


CROWDS = {
    'cohesive': Crowd(),
    'printed': Crowd(sheep=Morse(1.0, 2.0, 5e-4, 1e-2), dog=Morse(1e-2, 0.5, 5e-4, 1e-2)),
    'guided': Crowd(dog=Morse(2e-3, 0.1, 2e-2, 1.0)),
    'independent': Crowd(Morse(0.0, 1e-2, 0.0, 2.0), Harmonic(), friction=1.0, order=1),
    'sheep': Crowd(
        Morse(3.165, 1.044, 21.66, 20.0), Morse(2.802, 2.369, 0.0, 2.0), friction=0.2452,
        alignment=Alignment(4.191, 1.321), noise=0.998, common_noise=0.2689,
    ),
}  # fmt: skip
"""Crowds by name; `sheep` is the potential between two sheep, `dog` that of a dog on a sheep.

`cohesive` is the paper's with the two lengths swapped, so that the text's long-range
attraction and short-range repulsion hold; `printed` takes the paper literally, and the
crowd explodes. `guided` follows its dogs, which are guides: they attract, but not to
themselves, since both parts have the same slope at r = 0. `independent` sheep do not notice each
other and have no inertia, after the targets of Lama and di Bernardo (2024, arXiv:2307.16797): like
theirs they flee from dogs as fast as these run. `sheep` predicts real ones, 14 that a dog drove
in the recordings of Jadhav et al. (2024, Communications Biology 7, 1543), as `study real`
fits them: doc/real.md.
"""
