"""What killed nodes leave behind in shared memory, and how the next ones get over it.

Fast DDS keeps a file in /dev/shm for each port. A node that is killed while it makes one leaves it
half made, and the next node that gets this port waits for it to be finished, for ever.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
import fcntl
from pathlib import Path
import re
import time

_FOLDER = Path('/dev/shm')
_NAME = re.compile(r'fastrtps_(port\d+|[0-9a-f]+)')
_AGE = 3.0
"""What is younger may be about to be used [s]."""


def remove_what_nobody_uses(folder: Path = _FOLDER) -> None:
    """Remove ports and segments whose owners are gone.

    Fast DDS locks a file beside each, ending with _el (one owner) or _sl (several), as long as
    its owners live, in this or another container. Files of other users are left alone.
    """
    for file in folder.glob('fastrtps_*'):
        if not _NAME.fullmatch(file.name):
            continue
        with suppress(OSError), ExitStack() as locks:
            if time.time() - file.stat().st_mtime < _AGE:
                continue
            beside = [folder / f'{file.name}{ending}' for ending in ('_el', '_sl')]
            for lock in beside:
                locks.enter_context(_locked(lock))
            for each in (file, folder / f'sem.{file.name}_mutex', *beside):
                each.unlink(missing_ok=True)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock, if there is one; OSError when somebody else does."""
    if not path.exists():
        yield
        return
    with path.open('rb') as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
