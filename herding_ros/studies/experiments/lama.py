# SPDX-License-Identifier: Apache-2.0
"""Targets without cohesion, as Lama and di Bernardo (2024) herd them: the plant and their rule.

A. Lama, M. di Bernardo, Shepherding and herdability in complex multiagent systems, Physical
Review Research 6 (2024) L032012. Written from the equations as C. Punzo et al. restate them,
arXiv:2511.21405, eqs. 3, 6, 7, 10 and 14. Of targets T_a and herders H_i, the goal at the origin:

    T_a' = sqrt(2 D) N + beta sum (lambda - |T_a - H_i|) (T_a - H_i) / |T_a - H_i|
    H_i' = u_i,  |u_i| <= v_H

with the sum over the herders nearer than lambda. Targets do not notice each other. chi is the
fraction of targets in the goal region, the disc of radius rho around the origin; they are gathered
as soon as chi >= 0.99. All start uniformly in the disc of radius R.

The rule: a herder minds the targets that are within xi of it and nearer to it than to every other
herder, most of all those farthest from the goal, and runs to delta behind them:

    T_i = sum_a w_a T_a / sum_a w_a,  w_a = exp(gamma |T_a|)
    u_i = alpha (T_i + delta T_i / |T_i| - H_i), cut at v_H

Without such a target it runs to the boundary of the goal region at v_H. Values are the authors':
alpha 5, gamma 10, delta = lambda / 2; xi 10 or, as here, unlimited. Ours: commands hold for 0.05 s
instead of 0.01 s.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from herding_ros.model.simulation import Observation
from herding_ros.model.state import Array, HerdState
import numpy as np

GATHERED = 0.99
"""Fraction chi of the targets that has to be in the goal region."""


@dataclass(frozen=True)
class Setting:
    """A plant: numbers of herders and targets, D, R, rho and v_H; beta, lambda; the time grid.

    Times in s, lengths in m where the authors have arbitrary units.
    """

    herders: int = 10
    targets: int = 50
    diffusion: float = 1.0
    field: float = 50.0
    radius: float = 10.0
    max_speed: float = 7.5
    repulsion: float = 3.0
    reach: float = 2.5
    dt: float = 0.01
    substeps: int = 5

    @property
    def control_period(self) -> float:
        """Time for which a command holds [s]."""
        return self.dt * self.substeps


MAIN = Setting()
"""The authors' main setting."""

SMALL = Setting(herders=2, targets=7, diffusion=0.1, field=25.0, radius=5.0, max_speed=8.0)
"""A small herd with the values of Punzo et al., table I."""


class Targets:
    """The plant, a `Plant`; it is observed without errors."""

    goal = np.zeros(2)

    def __init__(self, setting: Setting, seed: int) -> None:
        """Start from the seed, which decides the noise as well."""
        self.setting, self.radius = setting, setting.radius
        self.control_period = setting.control_period
        start, self._process = np.random.default_rng(seed).spawn(2)
        x, d = (_in_disc(start, n, setting.field) for n in (setting.targets, setting.herders))
        self.state = HerdState(x, np.zeros_like(x), d)
        self.dog_velocities: Array = np.zeros_like(d)

    @property
    def arrived(self) -> bool:
        """Whether the targets are gathered."""
        return bool(self.inside().mean() >= GATHERED)

    def inside(self) -> Array:
        """Return which targets are in the goal region, (N,)."""
        return np.linalg.norm(self.state.x - self.goal, axis=1) <= self.radius

    def observe(self) -> Observation:
        """Return the true state; targets have no velocity of their own: zero."""
        return Observation(self.state, self.dog_velocities)

    def advance(self, u: Array) -> None:
        """Move on by one control period under the commands u (M, 2) [m/s], cut at v_H."""
        s, x, d = self.setting, self.state.x, self.state.d
        u = cut(u, s.max_speed)
        noise = self._process.standard_normal((s.substeps, *x.shape))
        for shock in math.sqrt(2.0 * s.diffusion * s.dt) * noise:
            x, d = x + s.dt * drift(x, d, s.repulsion, s.reach) + shock, d + s.dt * u
        self.state, self.dog_velocities = HerdState(x, np.zeros_like(x), d), u


def drift(x: Array, d: Array, repulsion: float, reach: float) -> Array:
    """Velocities (N, 2) of targets at x (N, 2) that flee herders at d (M, 2) within reach."""
    apart = x[:, None] - d
    r = np.linalg.norm(apart, axis=-1, keepdims=True)
    push = repulsion * np.maximum(reach - r, 0.0)
    return np.divide(push * apart, r, out=np.zeros_like(apart), where=r > 0.0).sum(axis=1)


@dataclass(frozen=True)
class Rule:
    """The authors' rule as a policy; radius: of the goal region [m].

    gain: alpha [1/s]; selectivity: gamma [1/m]; behind: delta [m]; sensing: xi [m].
    """

    radius: float
    max_speed: float
    gain: float = 5.0
    selectivity: float = 10.0
    behind: float = 1.25
    sensing: float = math.inf

    def __call__(self, observed: HerdState, t: float) -> Array:
        """Return the velocities (M, 2) [m/s] of the herders."""
        x, d = observed.x, observed.dogs
        r = np.linalg.norm(d[:, None] - x, axis=-1)
        away = np.linalg.norm(x, axis=1)
        mine = (np.arange(len(d))[:, None] == r.argmin(axis=0)) & (r <= self.sensing)
        exponents = np.where(mine, self.selectivity * away, -np.inf)
        busy = mine.any(axis=1)
        u = _home(d, self.radius, self.max_speed)
        w = np.exp(exponents[busy] - exponents[busy].max(axis=1, keepdims=True))
        chosen = (w / w.sum(axis=1, keepdims=True)) @ x
        outward = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
        u[busy] = self.gain * (chosen + self.behind * outward - d[busy])
        return cut(u, self.max_speed)


def _home(d: Array, radius: float, speed: float) -> Array:
    """Return velocities towards the goal region at this speed, and zero within it."""
    away = np.linalg.norm(d, axis=1, keepdims=True)
    return np.where(away > radius, -speed * d / np.maximum(away, radius), 0.0)


def cut(u: Array, limit: float) -> Array:
    """Return velocities (M, 2), none longer than the limit."""
    length = np.linalg.norm(u, axis=1, keepdims=True)
    return u * np.minimum(1.0, limit / np.maximum(length, limit))


def _in_disc(rng: np.random.Generator, n: int, radius: float) -> Array:
    """Draw n places (n, 2) uniformly in a disc around the origin."""
    r, angle = radius * np.sqrt(rng.random(n)), 2.0 * np.pi * rng.random(n)
    return r[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
