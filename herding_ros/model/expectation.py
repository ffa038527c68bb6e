# SPDX-License-Identifier: Apache-2.0
"""An expectation to a required standard error: paths are allocated to levels, and averaged.

The root mean square over the window of the standard error of the centre (a 2-vector) is what
`standard_error` means everywhere: sqrt(1/K sum_k sum_c Var[mean of coordinate c at step k]).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
import copy
from dataclasses import dataclass
import math
import os

import numpy as np

from .dynamics import check_control
from .kernels import PATHS
from .noise import NoisePaths
from .sampling import FineModel, interpolate, MonteCarloEstimator, Resolution, Sampler
from .state import Array

_MEMORY = 2**28
"""Noise of a level that is kept [bytes]; the rest is drawn again in each evaluation."""

_FEWEST = 2
"""Paths of a level that a variance is estimated from, if a block has fewer."""


@dataclass(frozen=True)
class Expectation:
    """Expected centre (K+1, 2) [m] under a control, and how it was found.

    standard_error [m]: see above, estimated from the paths. paths: of each level, from the
    coarsest on. work: what they cost, in paths of the fine model.
    """

    centre: Array
    standard_error: float
    paths: tuple[int, ...]
    work: float


def mean_centre(fine: FineModel, u: Array, noise: NoisePaths, threads: int | None = None) -> Array:
    """Return the mean of the sheep's centre (K+1, 2) [m] under u over the given noise paths."""
    if fine.at_once == PATHS:
        blocks = list(noise.blocks)
    else:
        blocks = [noise.path(i)[:, :, : fine.sheep] for i in range(noise.paths)]
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        centres = list(pool.map(Resolution().sampler(fine, u), blocks))
    return np.concatenate(centres, axis=2)[..., : noise.paths].mean(axis=2)


class Stream:
    """The noise of a level, block by block: the same blocks in each call."""

    def __init__(self, fine: FineModel, longer: int, seed: Sequence[int]) -> None:
        """Draw for this crowd, number of sheep and time grid; the state does not matter."""
        self._fine, self._longer = fine, longer
        self._rng = np.random.default_rng(seed)
        self._kept: list[Array] = []

    def blocks(self, first: int, stop: int) -> Iterator[Array]:
        """Yield the blocks with these numbers."""
        while len(self._kept) < stop and self._room():
            self._kept.append(self._fine.draw(self._rng, self._longer))
        yield from self._kept[first:stop]
        rng = copy.deepcopy(self._rng)
        for number in range(len(self._kept), stop):
            block = self._fine.draw(rng, self._longer)
            if number >= first:
                yield block

    def _room(self) -> bool:
        fine = self._fine
        size = fine.steps // self._longer * 2 * fine.sheep * fine.at_once * 8
        return (len(self._kept) + 1) * size <= _MEMORY


class Noise:
    """The noise of all levels of an estimator, from a seed; the finest level has the seed's own.

    For all fine models with the same crowd, number of sheep and time grid.
    """

    def __init__(self, fine: FineModel, estimator: MonteCarloEstimator, seed: int) -> None:
        """Draw nothing yet."""
        levels = estimator.levels(fine)
        self.streams = [
            Stream(fine, level.resolution.longer, [seed, len(levels) - 1 - number])
            for number, level in enumerate(levels)
        ]


class ExpectedCentre:
    """The expected centre as a function of the control.

    The first evaluation decides the number of paths of each level (Giles 2008): the least work
    that reaches the required standard error [m], but no more than that of `most` paths of the
    fine model, which is the work if the required standard error is 0. Later evaluations use the
    same paths and the same noise (common random numbers), so that the result is a smooth function
    of the control. Results have the same bits for any number of threads.
    """

    def __init__(
        self,
        fine: FineModel,
        estimator: MonteCarloEstimator,
        noise: Noise,
        standard_error: float,
        most: int,
        threads: int | None = None,
    ) -> None:
        """Use the estimator that `noise` was drawn for; compute nothing yet."""
        if most < _FEWEST:
            raise ValueError(f'most must be at least {_FEWEST} paths, got {most}')
        self._levels = estimator.levels(fine)
        self._noise = noise
        self._fine = fine
        self._standard_error, self._most = standard_error, most
        self._threads = threads or os.cpu_count() or 1
        self._paths: list[int] = []

    def __call__(self, u: Array) -> Expectation:
        """Return the expected centre under u (K / substeps, M, 2) [m/s]."""
        u = check_control(u, len(self._fine.state.d))
        samplers = [level.sampler(u) for level in self._levels]
        moments = [_Moments() for _ in self._levels]
        done = [0] * len(self._levels)
        with ThreadPoolExecutor(self._threads) as pool:
            needed = self._paths or self._pilot()
            while any(more > have for more, have in zip(needed, done, strict=True)):
                for number, (have, more) in enumerate(zip(done, needed, strict=True)):
                    self._add(moments[number], samplers[number], number, have, more, pool)
                    done[number] = max(have, more)
                needed = self._paths or self._allocate([each.variance for each in moments])
        self._paths = done
        return Expectation(
            centre=np.asarray(
                sum(
                    interpolate(each.mean, level.resolution.longer)
                    for each, level in zip(moments, self._levels, strict=True)
                )
            ),
            standard_error=math.sqrt(sum(each.variance / each.count for each in moments)),
            paths=tuple(done),
            work=sum(n * level.work for n, level in zip(done, self._levels, strict=True)),
        )

    def _pilot(self) -> list[int]:
        fewest = max(self._fine.at_once, _FEWEST)
        affordable = max(int(self._most / self._levels[-1].work), _FEWEST)
        return [fewest] * (len(self._levels) - 1) + [min(fewest, affordable)]

    def _allocate(self, variances: list[float]) -> list[int]:
        """Return the numbers of paths with the least work, from the variances of single ones."""
        works = [level.work for level in self._levels]
        total = sum(math.sqrt(v * w) for v, w in zip(variances, works, strict=True))
        if total == 0.0:
            return [0] * len(works)
        enough = total / self._standard_error**2 if self._standard_error else math.inf
        affordable = self._most / total
        ideal = [
            min(enough, affordable) * math.sqrt(v / w)
            for v, w in zip(variances, works, strict=True)
        ]
        if affordable < enough:
            return [int(n * (1.0 + 1e-12)) for n in ideal]
        block = self._fine.at_once
        return [-(-math.ceil(n) // block) * block for n in ideal]

    def _add(
        self,
        moments: _Moments,
        sampler: Sampler,
        level: int,
        first: int,
        stop: int,
        pool: ThreadPoolExecutor,
    ) -> None:
        """Add the paths from number first on, up to stop."""
        at_once = self._fine.at_once
        start = first // at_once
        blocks = self._noise.streams[level].blocks(start, -(-stop // at_once))
        for number, values in enumerate(self._in_order(pool, sampler, blocks), start):
            moments.add(values[:, :, max(first - number * at_once, 0) : stop - number * at_once])

    def _in_order(
        self, pool: ThreadPoolExecutor, sampler: Sampler, blocks: Iterable[Array]
    ) -> Iterator[Array]:
        """Compute block after block on all threads, with few of them in memory."""
        pending: deque[Future[Array]] = deque()
        for block in blocks:
            pending.append(pool.submit(sampler, block))
            if len(pending) > 2 * self._threads:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


class _Moments:
    """Mean and variance of paths that come in parts (Chan, Golub and LeVeque 1983)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean: Array = np.zeros(1)
        self._squares: Array = np.zeros(1)

    def add(self, values: Array) -> None:
        """Take in values (K+1, 2, paths)."""
        count = values.shape[2]
        if count == 0:
            return
        mean = values.mean(axis=2)
        change = mean - self.mean
        total = self.count + count
        self._squares = (
            self._squares
            + np.square(values - mean[:, :, None]).sum(axis=2)
            + np.square(change) * (self.count * count / total)
        )
        self.mean = self.mean + change * (count / total)
        self.count = total

    @property
    def variance(self) -> float:
        """Of a single path: the mean over the window of the coordinates' sum [m^2]."""
        return float(self._squares.sum()) / (self.count - 1) / (len(self._squares) - 1)
