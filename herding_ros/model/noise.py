# SPDX-License-Identifier: Apache-2.0
"""The random force on the sheep: sigma(t, x) dB, drawn here and nowhere else.

    sigma(t, x) = sigma f(t, x)
    dB^i = sqrt(1 - c) dW^i + sqrt(c) dW^0

with sigma = Crowd.noise, f = Crowd.noise_field, c = Crowd.common_noise, and independent Brownian
motions W^0 of all and W^i of sheep i. Whatever c is, B^i is a Brownian motion, and the correlation
of two sheep's is c: 0 is the paper's individual noise, 1 the common noise B^i = B of its remark.

What is drawn is sigma dB, which depends on no state; `random_force` multiplies it by f at the
beginning of each step (Ito). Since the force acts on velocities and f depends on positions alone,
Stratonovich's integral is the same, and Euler-Maruyama is Milstein's scheme: of strong order 1.
In a crowd of first order it acts on positions. There the integral is Ito's, and the strong order
1/2 where f depends on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import kernels
from .crowd import Crowd
from .kernels import PATHS
from .noise_field import NoiseField, NoiseFunction
from .state import Array


def increments(rng: np.random.Generator, crowd: Crowd, n: int, dt: float, steps: int) -> Array:
    """Draw sigma dB for n sheep: (steps, 2, lanes) [m/s], dB ~ N(0, dt) each."""
    noise = np.zeros((steps, 2, kernels.lanes(n)))
    noise[..., :n] = _brownian(rng, crowd, (steps, 2, n, 1))[..., 0]
    noise *= crowd.noise * np.sqrt(dt)
    return noise


@dataclass(frozen=True)
class NoisePaths:
    """Noise sigma dB of many paths, in the layout of the kernels.

    blocks (blocks, K, 2, n * PATHS) [m/s]: PATHS paths are integrated at once, those of a
    sheep side by side. The last block may hold more paths than the number `paths` that is used.
    """

    paths: int
    blocks: Array

    def path(self, i: int) -> Array:
        """Return the noise of path i for `rollout`, (K, 2, lanes) [m/s]."""
        block, lane = divmod(range(self.paths)[i], PATHS)
        values = self.blocks[block, :, :, lane::PATHS]
        out = np.zeros((*values.shape[:2], kernels.lanes(values.shape[2])))
        out[:, :, : values.shape[2]] = values
        return out


def noise_paths(
    rng: np.random.Generator, crowd: Crowd, n: int, dt: float, steps: int, paths: int
) -> NoisePaths:
    """Draw sigma dB for n sheep and K = steps of dt [s], with dB ~ N(0, dt) each."""
    blocks = _brownian(rng, crowd, (-(-paths // PATHS), steps, 2, n, PATHS))
    blocks *= crowd.noise * np.sqrt(dt)
    return NoisePaths(paths, blocks.reshape(*blocks.shape[:3], n * PATHS))


def _brownian(rng: np.random.Generator, crowd: Crowd, shape: tuple[int, ...]) -> Array:
    """Draw increments of the B^i for unit time; shape (..., 2, N, paths)."""
    own = rng.standard_normal(shape)
    if crowd.common_noise:
        common = rng.standard_normal((*shape[:-2], 1, shape[-1]))
        own *= np.sqrt(1.0 - crowd.common_noise)
        own += np.sqrt(crowd.common_noise) * common
    return own


def is_uniform(field: NoiseFunction) -> bool:
    """Whether sigma is the same everywhere and always, without an evaluation of the field."""
    return isinstance(field, NoiseField) and field.is_uniform


def factor(crowd: Crowd, t: float, x: Array) -> Array:
    """Return f(t, x), (N,) or (), at t [s] and the coordinates x (2, N) [m].

    Raises ValueError unless the field returns finite numbers of at least 0, one for each place
    or one for all.
    """
    # A copy: a function that changes its argument does not move sheep.
    places = np.array(x.T, order='C')
    found = crowd.noise_field(t, places)
    try:
        values = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'noise_field must return numbers at t = {t:g} s: {error}') from error
    shape = x.shape[1:]
    if values.shape not in (shape, ()):
        raise ValueError(
            f'noise_field must return shape {shape} or one number at t = {t:g} s, '
            f'got {values.shape}'
        )
    valid = np.isfinite(values) & (values >= 0.0)
    if not valid.all():
        i = int(np.argmin(valid))
        raise ValueError(
            f'noise_field must be finite and at least 0, got {values.flat[i]:g} at t = {t:g} s, '
            f'x = ({x[0, i]:g}, {x[1, i]:g}) m'
        )
    return values


def random_force(crowd: Crowd, t: float, x: Array, drawn: Array) -> Array:
    """Return sigma(t, x) dB at t [s] and x (2, N) [m], from sigma dB as drawn, (2, N) [m/s]."""
    return drawn if is_uniform(crowd.noise_field) else factor(crowd, t, x) * drawn


def strength(crowd: Crowd, t: float, x: Array) -> Array | float:
    """Return sigma(t, x) [m/s^1.5], (N,) or one number, at t [s] and places x (N, 2) [m]."""
    field = crowd.noise_field
    return crowd.noise if is_uniform(field) else crowd.noise * factor(crowd, t, x.T)
