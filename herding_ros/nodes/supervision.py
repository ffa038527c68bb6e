# SPDX-License-Identifier: Apache-2.0
"""Node processes: started with parameters, ended in order, and never left behind."""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
import signal
import subprocess
import sys

from .signals import END_WITH_STDIN

_PATIENCE = 20.0
"""Time that a child gets to end by itself [s]."""


class Child:
    """One node process; its output goes into a log file."""

    def __init__(self, name: str, parameters: Mapping[str, object], logs: Path) -> None:
        """Start the node with the given parameters: numbers, strings, paths, or lists."""
        self.name = name
        self.log = logs / f'{name}.log'
        arguments = [END_WITH_STDIN, '--ros-args']
        for key, value in parameters.items():
            arguments += ['-p', f'{key}:={written(value)}']
        # A session of its own: Ctrl-C reaches the children through us, in the right order. If we
        # are killed, their standard input ends, and they with it.
        self.process = subprocess.Popen(
            [sys.executable, '-m', f'herding_ros.nodes.{name}', *arguments],
            stdin=subprocess.PIPE,
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


def written(value: object) -> str:
    """Return a value as rcl reads it after `-p name:=`: JSON, all of which is YAML."""
    return json.dumps(value, ensure_ascii=False, default=str)
