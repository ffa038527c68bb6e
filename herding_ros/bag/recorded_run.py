# SPDX-License-Identifier: Apache-2.0
"""What was recorded of a run, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Topic:
    """One topic of the bag: its type, its messages and their rate [Hz] in the bag's time."""

    name: str
    type: str
    count: int
    rate: float


@dataclass(frozen=True)
class Replan:
    """What the controller said of one replan; a number that it did not say is NaN.

    time: when [s] from the first state; number: the running number; solve_ms: [ms];
    mapping_error_before, mapping_error_after: distance of the expected centre's path from the
    planned one; deadline_margin_s: [s], negative when the plan came late.
    """

    time: float
    number: int
    status: str
    solve_ms: float
    objective: float
    gradient_norm: float
    optimiser_iterations: float
    optimiser_calls: float
    mapping_iterations: float
    mapping_error_before: float
    mapping_error_after: float
    deadline_margin_s: float


@dataclass(frozen=True)
class RecordedRun:
    """A recorded run: T states of N sheep and M dogs, K commands.

    times: (T,) [s] from the first state; x: (T, N, 2) positions of the sheep [m];
    v: (T, N, 2) their velocities [m/s]; d: (T, M, 2) positions of the dogs [m];
    command_times: (K,) [s]; commands: (K, M, 2) the commands to the dogs [m/s], each until the
    next; goal: (2,) the last destination [m]; parameters: of each node by its full name;
    version: of the package that recorded, or ''; wall_s: wall time from the first to the last
    state [s].
    """

    times: Array
    x: Array
    v: Array
    d: Array
    command_times: Array
    commands: Array
    goal: Array
    replans: tuple[Replan, ...]
    parameters: dict[str, dict[str, Any]]
    version: str
    wall_s: float
    topics: tuple[Topic, ...]
    messages_lost: int | None = None
    """How many messages the recorder knew to be lost; None where it has not said."""
