# SPDX-License-Identifier: Apache-2.0
"""Potentials as the kernels take them: compiled functions of r**2, by formula or by table."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from herding_ros.model.jit import exact, INLINED, inlined, kernel, OPTIONS
from herding_ros.model.state import Array
from numba import types
from numba.extending import overload
import numpy as np

MorseCoefficients = tuple[float, float, float, float]
"""(C_r / l_r, 1 / l_r, C_a / l_a, 1 / l_a) of a Morse potential."""


class Table(NamedTuple):
    """P'/r of any potential P by cubic pieces in z = scale r**2, see `table`.

    On piece i it is c0[i] + c1[i] t + c2[i] t**2 + c3[i] t**3 with t = z less that at the
    beginning of the piece. low and high are the ends of all pieces, scale is in 1/m^2.
    """

    scale: float
    low: float
    high: float
    c0: Array
    c1: Array
    c2: Array
    c3: Array


PotentialForm = MorseCoefficients | Table
"""A potential in compiled code: each kernel is compiled for either."""


_LOG2_E = 1.0 / math.log(2.0)
# log(2) in two parts (as in fdlibm): n * _LN2_HIGH is exact for |n| < 2^20.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_UNDERFLOW = -700.0
# Doubles from 2^52 to 2^53 are whole numbers: adding this rounds to the nearest integer and
# leaves it in the lowest bits of the sum, negative ones as two's complement.
_ROUNDING = 1.5 * 2.0**52


@exact
def exp_neg(x: float) -> float:
    """e**x for x <= 0 in straight-line code, which the compiler vectorises.

    Relative error below 4e-16 for -700 <= x <= 0; e**-700 for anything smaller. Writes
    x = n log 2 + f with |f| <= log(2)/2, sums the Taylor series of e**f to degree 12
    (remainder f**13/13! < 2e-16) and adds n to the exponent bits.
    """
    x = max(x, _UNDERFLOW)
    rounded = x * _LOG2_E + _ROUNDING
    n = rounded - _ROUNDING
    f = (x - n * _LN2_HIGH) - n * _LN2_LOW
    f2 = f * f
    even = 1.0 / 479001600.0
    even = even * f2 + 1.0 / 3628800.0
    even = even * f2 + 1.0 / 40320.0
    even = even * f2 + 1.0 / 720.0
    even = even * f2 + 1.0 / 24.0
    even = even * f2 + 0.5
    odd = 1.0 / 39916800.0
    odd = odd * f2 + 1.0 / 362880.0
    odd = odd * f2 + 1.0 / 5040.0
    odd = odd * f2 + 1.0 / 120.0
    odd = odd * f2 + 1.0 / 6.0
    p = 1.0 + (f + f2 * (even + f * odd))
    exponent = np.float64(rounded).view(np.int64) << 52
    return np.int64(np.float64(p).view(np.int64) + exponent).view(np.float64)


# A piece of a table is as long as a double's leading bits last: its number and its beginning
# are read off the bits of z (bit-mapped tables; Wolff and Rudd 1999).
_PIECE_BITS = 7
_SHIFT = 52 - _PIECE_BITS
_BEGINNING = np.int64(-1) << _SHIFT


def table_nodes(low: float, high: float) -> Array:
    """Return ends of pieces that cover z from low > 0 to high, in increasing order."""
    first, last = (int(np.float64(end).view(np.int64)) >> _SHIFT for end in (low, high))
    return (np.arange(first, last + 2) << _SHIFT).view(np.float64)


def table(nodes: Array, a: Array, slope: Array, scale: float) -> Table:
    """Return the table with values a = P'/r and slopes da/dz at the `table_nodes`."""
    length = np.diff(nodes)
    mean = np.diff(a) / length
    return Table(
        scale,
        float(nodes[0]),
        float(np.nextafter(nodes[-1], 0.0)),
        a[:-1].copy(),
        slope[:-1].copy(),
        (3.0 * mean - 2.0 * slope[:-1] - slope[1:]) / length,
        (slope[:-1] + slope[1:] - 2.0 * mean) / length**2,
    )


def divided(p: PotentialForm, n: int) -> PotentialForm:
    """Return the potential divided by n."""
    if isinstance(p, Table):
        return p._replace(c0=p.c0 / n, c1=p.c1 / n, c2=p.c2 / n, c3=p.c3 / n)
    return (p[0] / n, p[1], p[2] / n, p[3])


@exact
def _piece(r2: float, p: Table) -> tuple[Any, float]:
    """Return the number of the piece that holds r2, and the distance from its beginning."""
    z = min(max(p.scale * r2, p.low), p.high)
    bits = np.float64(z).view(np.int64)
    first = np.float64(p.low).view(np.int64) >> _SHIFT
    t = z - np.int64(bits & _BEGINNING).view(np.float64)
    return np.uint64((bits >> _SHIFT) - first), t


@inlined
def _morse_slope_over_r(r2: float, p: MorseCoefficients) -> float:
    r = math.sqrt(r2)
    slope = p[2] * exp_neg(-p[3] * r) - p[0] * exp_neg(-p[1] * r)
    return slope / r if r2 > 0.0 else 0.0


@inlined
def _table_slope_over_r(r2: float, p: Table) -> float:
    i, t = _piece(r2, p)
    return p.c0[i] + t * (p.c1[i] + t * (p.c2[i] + t * p.c3[i]))


@inlined
def _morse_hessian(r2: float, p: MorseCoefficients) -> tuple[float, float]:
    r = math.sqrt(r2)
    attraction = p[2] * exp_neg(-p[3] * r)
    repulsion = p[0] * exp_neg(-p[1] * r)
    per_r2 = 1.0 / r2 if r2 > 0.0 else 0.0  # the only division: 1 / r = r / r2
    a = (attraction - repulsion) * r * per_r2
    b = (p[1] * repulsion - p[3] * attraction - a) * per_r2
    return a, b


@inlined
def _table_hessian(r2: float, p: Table) -> tuple[float, float]:
    i, t = _piece(r2, p)
    a = p.c0[i] + t * (p.c1[i] + t * (p.c2[i] + t * p.c3[i]))
    b = 2.0 * p.scale * (p.c1[i] + t * (2.0 * p.c2[i] + 3.0 * t * p.c3[i]))
    return a, b


def _by_form(morse: Any, table: Any) -> Any:
    """Return a function of r2 and a potential that is compiled for the potential's form."""

    def function(r2: float, p: PotentialForm) -> Any:
        raise NotImplementedError('to be called from compiled code')

    options: Any = {**OPTIONS, **INLINED}

    @overload(function, jit_options=options)
    def _choose(r2, p):  # type: ignore[no-untyped-def]  # Numba compares annotations
        if isinstance(p, types.UniTuple):
            return lambda r2, p: morse(r2, p)
        return lambda r2, p: table(r2, p)

    return function


_slope_over_r = _by_form(_morse_slope_over_r, _table_slope_over_r)
_hessian = _by_form(_morse_hessian, _table_hessian)


@inlined
def slope_over_r(r2: float, p: PotentialForm) -> float:
    """P'(r) / r at r**2 = r2, of a Morse potential zero at r = 0.

    The gradient of P(|s|) is this times s.
    """
    return _slope_over_r(r2, p)


@inlined
def hessian(r2: float, p: PotentialForm) -> tuple[float, float]:
    """(a, b) with a w + b (s.w) s = Hessian of P(|s|) times w, of Morse zero at s = 0.

    a = P'/r and b = (P'' - P'/r) / r**2, for r**2 = r2 = |s|**2. What a table gives is the
    exact derivative of its `slope_over_r`.
    """
    return _hessian(r2, p)


@kernel
def _pair_terms(r2: Array, p: PotentialForm, a: Array, b: Array) -> None:
    for i in range(r2.shape[0]):
        a[i], b[i] = hessian(r2[i], p)


def pair_terms(r2: Array, p: PotentialForm) -> tuple[Array, Array]:
    """Return a and b of `hessian` for an array of r2 [m^2] of any shape."""
    flat = np.ravel(r2).astype(np.float64)
    a, b = np.empty_like(flat), np.empty_like(flat)
    _pair_terms(flat, p, a, b)
    return a.reshape(np.shape(r2)), b.reshape(np.shape(r2))
