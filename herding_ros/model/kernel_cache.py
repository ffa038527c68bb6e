# SPDX-License-Identifier: Apache-2.0
"""Where compiled kernels are kept for those who may not write into the installation."""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
import os
from pathlib import Path
import shutil
import stat
import sys
import tempfile

_PACKAGE = Path(__file__).parents[1]


def find_cache() -> None:
    """Let Numba find the kernels that were compiled with the installation; call before its import.

    Numba uses only folders in which it may write. Who may not write into the installation gets a
    copy of its kernels: in the user's cache folder, or without one in a temporary folder.
    NUMBA_CACHE_DIR is respected.
    """
    if 'NUMBA_CACHE_DIR' in os.environ or is_writable(_PACKAGE / 'model' / '__pycache__'):
        return
    for base in _places():
        try:
            os.environ['NUMBA_CACHE_DIR'] = str(_copy_into(base))
            return
        except OSError:
            continue
    print(
        'compiled kernels cannot be kept, and compiling them takes a minute each time: '
        f'set NUMBA_CACHE_DIR to a folder that you can write, other than {_PACKAGE}',
        file=sys.stderr,
    )
    os.environ['NUMBA_CACHE_DIR'] = tempfile.mkdtemp(prefix='herding_ros-')


def has_kernels() -> bool:
    """Whether kernels have been compiled before, so that a program starts at once."""
    places = os.environ.get('NUMBA_CACHE_DIR') or _PACKAGE
    return any(Path(places).rglob('*.nbi'))


def is_writable(folder: Path) -> bool:
    """Whether files can be written into a folder, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _places() -> Iterator[Path]:
    cache = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    if os.path.isabs(cache):  # ~ is left as it is for who has no home
        yield Path(cache, 'herding_ros')
    yield Path(tempfile.gettempdir(), f'herding_ros-{os.getuid()}')


def _copy_into(base: Path) -> Path:
    """Return a folder for Numba in base, with a copy of the kernels there are."""
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = base.lstat()
    # Kernels are code: nobody else may write there, as anyone may into /tmp.
    if status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(f'{base} must belong to this user alone')
    kernels = sorted(_PACKAGE.rglob('__pycache__/*.nb[ic]'))
    stamps = ((str(path), path.stat().st_mtime_ns, path.stat().st_size) for path in kernels)
    folder = base / f'kernels-{hashlib.sha256(repr(list(stamps)).encode()).hexdigest()[:16]}'
    if not folder.exists():
        copy = Path(tempfile.mkdtemp(dir=base))
        for path in kernels:
            # Numba's own name for the place of what belongs into a source folder.
            source = path.parents[1]
            name = f'{source.name}_{hashlib.sha1(str(source).encode()).hexdigest()}'
            (copy / name).mkdir(exist_ok=True)
            shutil.copy(path, copy / name)
        try:
            copy.rename(folder)
        except OSError:  # another process was faster
            shutil.rmtree(copy)
            if not folder.is_dir():
                raise
    if not is_writable(folder):
        raise PermissionError(f'{folder} must be writable')
    return folder
