# SPDX-License-Identifier: Apache-2.0
"""What lies beyond the horizon: a stray costs on until a dog is behind it."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.control.detour import detour
from herding_ros.control.errands import Errands
from herding_ros.model.state import Array, Trajectory
import numpy as np

from .cost import Derivatives

_SMOOTHING = 0.2
"""Distances are rounded off below this part of the standoff."""


@dataclass(frozen=True)
class CostToGo:
    """The running cost of strays for as long as their dogs still need to get behind them.

    C = sum over pairs (m, i) of  b/(2N) (r_i^2 - r0^2)+  L(d_m, p_i) / u_max

    at the end of the window: r_i is the distance of stray i from where it is brought, r0 that
    within which it needs no fetching, p_i the post at the standoff behind it, L the length of the
    dog's way round the flock (`detour`), and b = spread_weight. L / u_max is the time that the
    dog needs, and the factor before it what the stray adds to the tracking cost meanwhile. A dog
    that is behind its stray has nothing to go: from there on the window sees what it can do.
    A stray with a wall before it is brought to where its way turns first, and r_i is the length of
    all its way.

    A dog without an errand that is not felt by the flock costs the same, with all sheep at
    a distance of reach, until it is within reach; and so does one that has to get behind the
    flock, until it is there.
    """

    errands: Errands
    spread_weight: float
    max_speed: float

    def value_and_derivatives(self, trajectory: Trajectory, u: Array) -> tuple[float, Derivatives]:
        """Return C and its derivatives by the last positions of sheep and dogs."""
        errands, n = self.errands, trajectory.n
        x, d = trajectory.xs[-1, :, :n].T, trajectory.ds[-1, :2].T
        by_x, by_d, by_place = np.zeros_like(x), np.zeros_like(d), np.zeros(2)
        place = errands.place(x)
        value = 0.0
        if len(errands.dogs):
            straight = np.isnan(errands.via[:, 0])
            places, rest = errands.places(x), errands.rest[:, None]
            off = x[errands.sheep] - places
            r = np.linalg.norm(off, axis=1, keepdims=True)
            unit = off / np.maximum(r, 1e-12)
            ends = d[errands.dogs] - places, off + errands.standoff * unit
            way, by_dog, by_post = detour(*ends, errands.around)
            if not straight.all():
                for round_, direct in zip((way, by_dog, by_post), detour(*ends, 0.0), strict=True):
                    round_[~straight] = direct[~straight]
            time, by_way = self._time(way)
            scale = self.spread_weight / (2.0 * n)
            rate = scale * np.maximum((r + rest) ** 2 - errands.inner**2, 0.0)
            value += float((rate * time).sum())
            by_d[errands.dogs] += rate * by_way * by_dog
            # The post moves with its sheep, and turns round it with the direction to the place.
            across = errands.standoff / np.maximum(r, 1e-12)
            turned = across * (by_post - unit * (unit * by_post).sum(axis=1, keepdims=True))
            by_off = 2.0 * scale * off * (rate > 0.0) * time
            by_off *= 1.0 + rest / np.maximum(r, 1e-12)
            by_off += rate * by_way * (by_post + turned)
            by_x[errands.sheep] += by_off
            by_place -= (by_off + rate * by_way * by_dog)[straight].sum(axis=0)
        idle = errands.idle
        off = d[idle] - place
        r = np.linalg.norm(off, axis=1, keepdims=True)
        beyond = np.maximum(r - errands.around - errands.reach, 0.0)
        rate = self.spread_weight * errands.reach**2 / (2.0 * len(d) * self.max_speed)
        # Squared within a reach, so that the derivative has no jump.
        near = beyond < errands.reach
        length = np.where(near, beyond**2 / (2.0 * errands.reach), beyond - 0.5 * errands.reach)
        value += rate * float(length.sum())
        slope = np.where(near, beyond / errands.reach, 1.0)
        by_idle = rate * slope * off / np.maximum(r, 1e-12)
        by_d[idle] += by_idle
        by_place -= by_idle.sum(axis=0)
        drivers = errands.drivers
        if len(drivers):
            # Meanwhile nothing is gained by it within a window.
            back = np.broadcast_to(errands.behind, (len(drivers), 2))
            way, by_dog, _ = detour(d[drivers] - place, back, errands.around)
            time, by_way = self._time(way)
            rate = self.spread_weight * errands.reach**2 / (2.0 * len(d))
            value += rate * float(time.sum())
            by_d[drivers] += rate * by_way * by_dog
            by_place -= rate * (by_way * by_dog).sum(axis=0)
        if errands.goal is None:
            by_x[errands.together] += by_place / errands.together.sum()
        xs, ds = np.zeros_like(trajectory.xs), np.zeros_like(trajectory.ds)
        xs[-1, :, :n], ds[-1, :2] = by_x.T, by_d.T
        return value, Derivatives(x=xs, d=ds)

    def _time(self, way: Array) -> tuple[Array, Array]:
        """Return how long dogs need for ways (k,) [m], (k, 1) [s], and the derivatives [s/m]."""
        width = _SMOOTHING * self.errands.standoff
        rounded = np.sqrt(way**2 + width**2)
        return (
            (rounded - width)[:, None] / self.max_speed,
            (way / rounded)[:, None] / self.max_speed,
        )
