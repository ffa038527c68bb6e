# SPDX-License-Identifier: Apache-2.0
"""The signals that end a process, without exceptions in the middle of something."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
import os
import signal
import sys
import threading

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The signals that ask a process to end; the last one says that its terminal was closed."""

END_WITH_STDIN = '--end-with-stdin'
"""The option of a node that ends when its standard input does, so with its parent."""


def handle(handler: Callable[[], None]) -> None:
    """Call handler at each signal that asks to end; `nohup` still keeps out SIGHUP."""
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: handler())


def end_with_stdin() -> None:
    """Ask this process to end, as SIGTERM does, when its standard input has ended."""

    def wait() -> None:
        with suppress(OSError):  # a terminal that is gone
            while os.read(0, 1024):
                pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, daemon=True).start()


class Signals:
    """End the process with exit code 0 at a signal, until there is something to call instead.

    Python's handlers run only when the main thread comes to it, and rclpy's shut the context
    down under the last messages. The byte that Python writes at once wakes a thread instead.
    """

    def __init__(self) -> None:
        # While the node is made, kernels may be compiling, and no other node has seen it.
        self._act: Callable[[], None] = partial(exit_at_once, 0)
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        handle(lambda: None)

        def wait() -> None:
            os.read(reading, 1)
            self._act()

        threading.Thread(target=wait, daemon=True).start()

    def call(self, act: Callable[[], None]) -> None:
        """Call act, in a thread of its own, at the first signal."""
        self._act = act


class Noted:
    """Whether something has happened; unlike an Event it may be set in a signal handler.

    A signal that comes while the handler of another sets an Event waits for a lock that is held by
    what it interrupts: for ever.
    """

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Note that it has happened."""
        self._is_set = True

    def is_set(self) -> bool:
        """Return whether it has happened."""
        return self._is_set


def note_signals() -> Noted:
    """Return what the signals set, and do nothing else."""
    noted = Noted()
    handle(noted.set)
    return noted


def ignore_signals() -> None:
    """Keep further signals out of the exit code: Python gives them their default back."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def exit_at_once(code: int) -> None:
    """Flush the output and end without freeing anything."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
