# SPDX-License-Identifier: Apache-2.0
"""How kernels are compiled: the options of Numba, in one place.

Kernels release the GIL and are cached on disk. The order of summation is fixed at compile time,
so results repeat bit for bit.
"""

from __future__ import annotations

from typing import Any

from numba import njit

from .compile_notice import announce_compiling

announce_compiling()

OPTIONS: dict[str, Any] = {'cache': True, 'nogil': True, 'error_model': 'numpy'}

# 'reassoc' lets the compiler sum rows in vector registers, 'contract' lets it fuse
# multiply-adds. NaN and infinity keep their meaning.
_FAST: dict[str, Any] = {'fastmath': {'reassoc', 'contract', 'nsz'}}
INLINED: dict[str, Any] = {**_FAST, 'forceinline': True}

kernel = njit(**OPTIONS, **_FAST)

inlined = njit(**OPTIONS, **INLINED)
"""For what is called in an innermost loop: the loop could not be vectorised otherwise."""

exact = njit(**OPTIONS, fastmath={'contract'}, forceinline=True)
"""For what depends on the order of its operations: no reassociation."""
