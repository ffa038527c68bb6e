# SPDX-License-Identifier: Apache-2.0
"""Says that kernels are being compiled, and how it goes: it may take a minute, in silence else."""

from __future__ import annotations

import multiprocessing
import sys
import time
from typing import Any

from numba.core import event

_WORTH_A_LINE = 1.0
"""Shortest time to compile a kernel that gets a line [s]."""


class _Notice(event.Listener):
    """Follows what Numba compiles; kernels that it finds on disk cause no events."""

    def __init__(self) -> None:
        self._depth = 0
        self._begun = 0.0
        self._is_said = False

    def on_start(self, event: Any) -> None:
        """Announce the first kernel, before it is compiled."""
        if not self._depth:
            self._begun = time.monotonic()
        self._depth += 1
        if not self._is_said:
            self._is_said = True
            _say('compiling kernels for this processor, once, for up to a minute ...')

    def on_end(self, event: Any) -> None:
        """Tell of a kernel that took long, with those that it calls."""
        self._depth -= 1
        took = time.monotonic() - self._begun
        if not self._depth and took > _WORTH_A_LINE:
            _say(f'compiled {event.data["dispatcher"].py_func.__name__} in {took:.0f} s')


def _say(text: str) -> None:
    if sys.stderr is not None:
        print(f'herding_ros: {text}', file=sys.stderr, flush=True)


def announce_compiling() -> None:
    """Announce on stderr when kernels are compiled in this process, unless it is a worker."""
    if multiprocessing.parent_process() is None:
        event.register('numba:compile', _Notice())
