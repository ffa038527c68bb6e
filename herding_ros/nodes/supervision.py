# SPDX-License-Identifier: Apache-2.0
"""Node processes: started with parameters, ended in order."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import signal
import subprocess
import sys

_PATIENCE = 20.0
"""Time that a child gets to end by itself [s]."""


class Child:
    """One node process; its output goes into a log file."""

    def __init__(self, name: str, parameters: Mapping[str, object], logs: Path) -> None:
        """Start the node with the given parameters."""
        self.name = name
        self.log = logs / f'{name}.log'
        arguments = ['--ros-args']
        for key, value in parameters.items():
            arguments += ['-p', f'{key}:={_yaml(value)}']
        # A session of its own: Ctrl-C reaches the children through us, in the right order.
        self.process = subprocess.Popen(
            [sys.executable, '-m', f'herding_ros.nodes.{name}', *arguments],
            stdin=subprocess.DEVNULL,
            stdout=self.log.open('wb'),
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def died(self) -> bool:
        """Whether the process has ended."""
        return self.process.poll() is not None

    def end(self) -> None:
        """Ask the node to end, and kill it if it does not."""
        if not self.died:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def last_lines(self) -> str:
        """Return the last lines of its log."""
        return '\n'.join(self.log.read_text(errors='replace').splitlines()[-12:])


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(_yaml(float(each)) for each in value) + ']'
    return repr(value) if isinstance(value, float) else str(value)
