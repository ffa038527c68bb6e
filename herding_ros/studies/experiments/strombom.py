# SPDX-License-Identifier: Apache-2.0
"""The heuristic of Strömbom et al. (2014): collect strays, else drive from behind.

D. Strömbom, R. P. Mann, A. M. Wilson, S. Hailes, A. J. Morton, D. J. T. Sumpter, A. J. King,
Solving the shepherding problem: heuristics for herding autonomous, interacting agents, Journal
of the Royal Society Interface 11 (2014) 20140719. Written from the published rules. What is
published, with r_a the distance that sheep keep from each other and N their number:

- If all sheep are within f(N) = r_a N^(2/3) of their centre, drive: run to the point r_a
  sqrt(N) behind the centre, as seen from the destination.
- Else collect: run to the point r_a behind the sheep that is farthest from the centre, as seen
  from the centre.
- Within 3 r_a of any sheep, run slowly: 0.3 r_a instead of 1.5 m in a time step, r_a = 2 m.
- Directions have noise: a random unit vector times e = 0.3 is added before normalising.

Ours: there are several dogs. Strays are collected by as many dogs as there are strays, the
farthest strays first; the others drive, from posts side by side on an arc behind the flock. Dogs
take the posts so that the sum of their distances is least. With one dog these are the published
rules.
"""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.control.errands import behind_each
from herding_ros.control.rules.rule import behind, nearest_posts, SIDE_BY_SIDE
from herding_ros.control.ways import Ways
from herding_ros.model.flock import centre
from herding_ros.model.state import Array, HerdState
import numpy as np


@dataclass
class Strombom:
    """The heuristic as a policy.

    goal: (2,) [m]; max_speed [m/s]; sheep_distance: r_a [m]; slow: fraction of max_speed near
    sheep; noise: e; arc: angle between neighbouring drivers, seen from the flock's centre [rad];
    ways: that dogs take among walls.
    """

    goal: Array
    rng: np.random.Generator
    max_speed: float = 0.05
    sheep_distance: float = 0.2
    slow: float = 0.4
    noise: float = 0.3
    arc: float = SIDE_BY_SIDE
    ways: Ways | None = None

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the dogs' velocities (M, 2) [m/s]."""
        posts = nearest_posts(observed.dogs, self.posts(observed.x, len(observed.dogs)))
        if self.ways is not None:
            posts = self.ways.steps(observed.dogs, self.ways.in_front(observed.x, posts))
        offset = posts - observed.dogs
        left = np.linalg.norm(offset, axis=1, keepdims=True)
        angle = self.rng.uniform(0.0, 2.0 * np.pi, len(offset))
        heading = unit(offset) + self.noise * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        gaps = np.linalg.norm(observed.dogs[:, None] - observed.x, axis=-1).min(axis=1)
        speed = np.where(gaps < 3.0 * self.sheep_distance, self.slow, 1.0) * self.max_speed
        # A dog closer than the distance of a control period would run to and fro.
        return unit(heading) * np.minimum(speed[:, None], left / _PATIENCE)

    def posts(self, x: Array, dogs: int) -> Array:
        """Return the posts of the dogs (dogs, 2) [m] for sheep at x (N, 2) [m]."""
        r, n, middle = self.sheep_distance, len(x), centre(x)
        away = np.linalg.norm(x - middle, axis=1)
        strays = [i for i in np.argsort(-away, kind='stable') if away[i] > r * n ** (2.0 / 3.0)]
        strays = strays[:dogs]
        collect = behind_each(x[strays], middle, r)
        drive = behind(middle, r * np.sqrt(n), self.goal, dogs - len(strays), self.arc)
        return np.concatenate([collect, drive])


_PATIENCE = 0.1
"""A post closer than the distance that a dog covers in this time [s] is approached slowly."""


def unit(vectors: Array) -> Array:
    """Return vectors (..., 2) at length 1; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
