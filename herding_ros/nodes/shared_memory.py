"""What killed programs leave half made in shared memory, and how the next ones get over it.

Fast DDS keeps a file in /dev/shm for each port. A program that is killed while it makes one leaves
it half made, and the next one that gets this port waits for it to be finished, for ever.
"""

from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import re
import sys
import time

_FOLDER = Path('/dev/shm')
_PORT = re.compile(r'fastrtps_port\d+')
_MADE = (2).to_bytes(4, sys.byteorder)
"""The first word of what is made, as Boost.Interprocess writes it (0 and 1: not yet)."""

_AGE = 3.0
"""What is younger may be being made right now [s]."""


def remove_half_made_ports(folder: Path = _FOLDER) -> None:
    """Remove ports that nobody is going to finish.

    All others stay, also those that seem to have no owner: a living program may still be connected
    with one, and would take a new one of the same number for it. Files of other users stay too.
    """
    for file in folder.glob('fastrtps_port*'):
        if _PORT.fullmatch(file.name):
            with suppress(OSError):
                _remove_if_half_made(file)


def _remove_if_half_made(port: Path) -> None:
    with port.open('rb') as file:
        # Of several that start at once, one removes it; to the others it is gone already.
        fcntl.flock(file, fcntl.LOCK_EX)
        opened = os.fstat(file.fileno())
        half_made = file.read(len(_MADE)) != _MADE and time.time() - opened.st_mtime > _AGE
        if half_made and os.path.samestat(opened, port.stat()):
            port.unlink()
