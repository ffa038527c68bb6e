# SPDX-License-Identifier: Apache-2.0
"""What can be known of recorded sheep in advance: predictions without the forces of a crowd.

The displacement of the flock's centre is predicted as a sum of vectors that are known, times
numbers that are the same in both coordinates and found by least squares. What a crowd misses of
it is in these vectors, or in none of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from herding_ros.control.parameters import Sensor
from herding_ros.fit.least_squares import LEADS, Predictor
from herding_ros.fit.recording import Recording
from herding_ros.model.crowd import CROWDS
from herding_ros.model.flock import centre
from herding_ros.model.state import Array
import numpy as np

from .real import drives, SENSOR

KNOWN = (
    'its velocity',
    'and the way of its last second',
    'and where the dog is and runs',
    'and where the dog will be',
)
"""What is known of the centre, each with all before it."""

_SOON = 0.3
"""Time over which a dog's velocity is taken [s]."""

_AROUND = 0.2
"""Velocities as they look later are displacements from so long before to so long after [s]."""


def limits(data: str, known: Sequence[int], folds: int, path: str) -> dict[str, Any]:
    """Return errors of predictions at the leads, root mean square [m].

    data: name of the drives in the file `path`; known: numbers of drives, divided in so many
    folds. Under 'centre' of the flock's centre, for each of KNOWN, each fold predicted from the
    others; under 'sheep' of single sheep by the preset, from velocities 'as known' at the time and
    'as they look later'.
    """
    every = drives(Path(path))
    some = [every[i] for i in known]
    errors: dict[str, list[float]] = {name: [] for name in KNOWN}
    for lead in LEADS:
        parts = [_known(each, lead) for each in some]
        for count, name in enumerate(KNOWN, 1):
            squares = [_squares(parts, fold, folds, count) for fold in range(folds)]
            errors[name].append(float(np.sqrt(np.concatenate(squares).mean())))
    later = [replace(each, v=_velocities_later(each)) for each in some]
    crowd, exact = CROWDS['sheep'], Sensor(SENSOR.position_noise, SENSOR.position_noise)
    return {
        'centre': errors,
        'sheep': {
            'as known': Predictor(some).predict(crowd, SENSOR).rms.tolist(),
            'as they look later': Predictor(later).predict(crowd, exact).rms.tolist(),
        },
    }


def _squares(
    parts: Sequence[tuple[list[Array], Array]], fold: int, folds: int, count: int
) -> Array:
    """Return the squared errors (S,) [m^2] of a fold, from so many groups of what is known."""

    def of(chosen: Sequence[int]) -> tuple[Array, Array]:
        groups = [np.concatenate(parts[i][0][:count]) for i in chosen]
        return np.concatenate(groups, axis=1), np.concatenate([parts[i][1] for i in chosen])

    there, moved = of([i for i in range(len(parts)) if i % folds != fold])
    factors = np.linalg.lstsq(there.reshape(len(there), -1).T, moved.ravel(), rcond=None)[0]
    here, truth = of(range(fold, len(parts), folds))
    return np.asarray(np.square(np.tensordot(factors, here, 1) - truth).sum(axis=1))


def _known(recording: Recording, lead: float) -> tuple[list[Array], Array]:
    """Return groups (F, S, 2) of what is known at S starts, and how far the centre moves (S, 2).

    Starts are one second apart.
    """
    between = float(np.diff(recording.times).mean())
    second, ahead, soon = (round(time / between) for time in (1.0, lead, _SOON))
    k = np.arange(second, len(recording.times) - ahead, second)
    middle, dog = centre(recording.x), recording.d[:, 0]
    away = middle[k] - dog[k]
    groups = [
        [middle[k] - middle[k - 1]],
        [middle[k] - middle[k - second]],
        [away, away / np.linalg.norm(away, axis=1, keepdims=True),
         dog[k] - dog[k - soon], dog[k] - dog[k - second]],
        [dog[k + ahead] - dog[k], dog[k + ahead // 2] - dog[k]],
    ]  # fmt: skip
    return [np.array(group) for group in groups], middle[k + ahead] - middle[k]


def _velocities_later(recording: Recording) -> Array:
    """Return velocities (T, N, 2) [m/s] that look a little ahead."""
    times, x = recording.times, recording.x
    instants = np.arange(len(times))
    steps = round(_AROUND / float(np.diff(times).mean()))
    first, last = np.maximum(instants - steps, 0), np.minimum(instants + steps, instants[-1])
    return np.asarray((x[last] - x[first]) / (times[last] - times[first])[:, None, None])
