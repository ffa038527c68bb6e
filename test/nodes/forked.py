# SPDX-License-Identifier: Apache-2.0
"""Nodes as forks of a process that has loaded them: a start takes 0.1 s instead of seconds.

Such a node is a process of its own and differs from `python -m herding_ros.nodes.sim` only in
that imports and kernels are there when `main` begins.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from multiprocessing import forkserver, get_context
import os
from pathlib import Path
import signal
import subprocess
import sys

NODES = ('controller', 'recorder', 'sim')
"""Names of the nodes that can be started so."""


class Forked:
    """A node's process; the interface is that of `subprocess.Popen`, as far as tests need it."""

    def __init__(self, name: str, arguments: list[str], env: dict[str, str], log: Path) -> None:
        _start_server()
        self._process = get_context('forkserver').Process(
            target=_run, args=(name, arguments, env, log)
        )
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(str(self._process), timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended, which is known a moment later
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _start_server() -> None:
    """Start the process that forks nodes, unless it is there; it ends with this one."""
    forkserver.set_forkserver_preload(['preloaded'])
    path = os.environ.get('PYTHONPATH')
    os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, [str(Path(__file__).parent), path]))
    try:
        forkserver.ensure_running()
    finally:
        if path is None:
            del os.environ['PYTHONPATH']
        else:
            os.environ['PYTHONPATH'] = path


def _run(name: str, arguments: list[str], env: dict[str, str], log: Path) -> None:
    os.environ.clear()
    os.environ.update(env)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(output, stream)
    if 'preloaded' not in sys.modules:
        sys.exit('the server that forks nodes could not load them; import preloaded.py by hand')
    sys.argv[:] = [name, *arguments]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(import_module(f'herding_ros.nodes.{name}').main())
