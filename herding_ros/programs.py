# SPDX-License-Identifier: Apache-2.0
"""The programs by their names, with terminal and signals in order before anything is loaded.

Loading a program takes seconds, in which Ctrl-C comes too. And no output may end one: characters
that a terminal does not have are written as escapes, and what nobody reads any more, behind
`| head -1` or when the terminal was closed, is dropped.
"""

from __future__ import annotations

import errno
from functools import partial
import gc
from importlib import import_module
import io
import os
import signal
import sys
from typing import Any

INTERRUPTED = 130
"""Exit code of a program that a signal has ended before its work was done."""

SHARED_MEMORY = 64 * 1024
"""Room that a program with other processes needs in /dev/shm [byte].

Without any, LTTng, which rclpy loads, ends the process by SIGBUS, without a word.
"""

_UNREAD = (errno.EPIPE, errno.EIO)


def _run(
    name: str, module: str, interrupted: int = INTERRUPTED, help_module: str | None = None
) -> int:
    """Run a program; until it takes care of signals itself, one ends it with that exit code.

    `help_module` can answer `--help` before the program is loaded.
    """
    guard_output()
    signals = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.getsignal(number) for number in signals}
    for number in signals:
        signal.signal(number, partial(_leave, name, interrupted))
    gc.disable()  # to look for garbage in what is being loaded takes a tenth of the time
    if help_module is not None:
        import_module(f'herding_ros.{help_module}').answer_help(name)
    free = _free_shared_memory()
    if module.startswith(('nodes.', 'studies.')) and free < SHARED_MEMORY:
        print(
            f'{name}: /dev/shm must have {SHARED_MEMORY} bytes free, got {free}: '
            'remove what fills it',
            file=sys.stderr,
        )
        return 2
    main = import_module(f'herding_ros.{module}').main
    gc.enable()
    for number, handler in before.items():
        signal.signal(number, handler)
    try:
        return int(main())
    except KeyboardInterrupt:
        print(f'{name}: interrupted', file=sys.stderr)
        return interrupted


def _free_shared_memory() -> int:
    """Return the free bytes in /dev/shm; enough where there is no such folder."""
    try:
        disk = os.statvfs('/dev/shm')
    except OSError:
        return SHARED_MEMORY
    return disk.f_bavail * disk.f_frsize


def _leave(name: str, code: int, *_: Any) -> None:
    """End at once: an exception could get lost in what is being imported."""
    os.write(2, f'{name}: interrupted while loading\n'.encode())
    os._exit(code)


def guard_output() -> None:
    """Let nothing that is printed end this program."""
    for name in ('stdout', 'stderr'):
        stream = getattr(sys, name)
        if stream is not None:  # closed by the shell: >&-
            raw = io.BufferedWriter(_Unbreakable(stream.fileno(), 'w', closefd=False))
            guarded = io.TextIOWrapper(
                raw, stream.encoding, 'backslashreplace', line_buffering=stream.line_buffering
            )
            setattr(sys, name, guarded)


class _Unbreakable(io.FileIO):
    """Drops what is written once nobody reads it."""

    def write(self, data: Any, /) -> int:
        """Write bytes, or return as if they had been written."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _UNREAD:
                raise
            return memoryview(data).nbytes


# A node that was asked to end has done its work.
sim = partial(_run, 'sim', 'nodes.sim', 0, 'nodes.command_line')
controller = partial(_run, 'controller', 'nodes.controller', 0, 'nodes.command_line')
recorder = partial(_run, 'recorder', 'nodes.recorder', 0, 'nodes.command_line')
view = partial(_run, 'view', 'nodes.view', 0, 'nodes.command_line')
herd = partial(_run, 'herd', 'nodes.herd')
recover = partial(_run, 'recover', 'bag.cli')
fit = partial(_run, 'fit', 'fit.cli')
report = partial(_run, 'report', 'report.cli')
study = partial(_run, 'study', 'studies.cli')
