# SPDX-License-Identifier: Apache-2.0
"""Describes the machine that the figures were taken on, without its owner."""

from __future__ import annotations

from datetime import datetime, timezone
from functools import cache
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform
import subprocess

from llvmlite import binding

_VECTORS = ('avx', 'avx2', 'fma', 'avx512f', 'avx512dq', 'avx512vl')
_PACKAGES = ('numpy', 'numba', 'scipy', 'jax', 'jaxlib', 'casadi', 'pytest-benchmark')


@cache
def describe() -> dict[str, str]:
    """Return what influences the figures, as it was at the first call."""
    cpu = _first_cpu()
    flags = cpu.get('flags', '').split()
    return {
        'processor': cpu.get('model name', platform.machine()),
        'cores': str(len(os.sched_getaffinity(0))),
        'vector extensions': ' '.join(flag for flag in _VECTORS if flag in flags) or 'unknown',
        'L2 per core': _read('/sys/devices/system/cpu/cpu0/cache/index2/size', 'unknown'),
        'load before': f'{os.getloadavg()[0]:.1f}',
        'system': f'{_system()}, Linux {platform.release().partition("-")[0]}',
        'Python': platform.python_version(),
        'LLVM': '.'.join(map(str, binding.llvm_version_info)),
        **{name: _version(name) for name in _PACKAGES},
        'herding_ros': _git_describe(),
        'date': datetime.now(timezone.utc).strftime('%Y-%m-%d'),
    }


def _read(path: str, otherwise: str) -> str:
    try:
        return Path(path).read_text(encoding='utf-8').strip()
    except OSError:
        return otherwise


def _first_cpu() -> dict[str, str]:
    lines = _read('/proc/cpuinfo', '').split('\n\n')[0].splitlines()
    pairs = (line.partition(':') for line in lines)
    return {key.strip(): value.strip() for key, _, value in pairs}


def _system() -> str:
    try:
        return platform.freedesktop_os_release()['PRETTY_NAME']
    except (OSError, KeyError):
        return 'unknown'


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'not installed'


def _git_describe() -> str:
    command = ['git', 'describe', '--always', '--dirty']
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, cwd=Path(__file__).parent
        )
    except (OSError, subprocess.CalledProcessError):
        return 'unknown'
    return done.stdout.strip()
