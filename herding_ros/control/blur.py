# SPDX-License-Identifier: Apache-2.0
"""How dogs are felt on average by sheep whose places noise has made uncertain."""

from __future__ import annotations

from dataclasses import replace
import math

from herding_ros.model.crowd import Crowd
from herding_ros.model.potentials import Mollified

from .reach import Reach
from .surprise import displacement_variance

_SMALL = 0.25
"""Part of the standoff up to which an uncertain place makes little difference."""


def blurred(crowd: Crowd, time: float, max_speed: float) -> Crowd:
    """Return the crowd with the dogs' potential convolved with where noise takes a sheep.

    A plan that is looked at again after a time [s] does not know better where a sheep is until
    then. Without noise it is driven fastest from close behind, but there a small step aside turns
    the push aside, too. What is to be expected of a push is that of the convolved potential, which
    is weak near by: so dogs keep their distance. The same crowd where sheep move by less than
    a quarter of the standoff of dogs with this speed limit [m/s], or notice no dog.
    """
    reach = Reach.of(crowd, max_speed)
    width = crowd.noise * math.sqrt(displacement_variance(crowd, time))
    if reach is None or width <= _SMALL * reach.standoff:
        return crowd
    return replace(crowd, dog=Mollified(crowd.dog, width))
