# SPDX-License-Identifier: Apache-2.0
"""Forces on the sheep from the world in compiled code.

A new force is a class with `kernel_form`, and two functions of a sheep's place that are given to
`register`. Rollouts, ensembles, adjoints and large flocks take it from there: kernels are
compiled for the form that they meet, and without one to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
import inspect
from typing import Any

from numba import types
from numba.extending import overload
import numpy as np

from .external_form import ExternalForm, Form
from .jit import INLINED, inlined, OPTIONS
from .state import Array

_COMPILED: Any = {**OPTIONS, **INLINED}


def register(
    name: str,
    force_of: Callable[[float, float, Any], tuple[float, float]],
    product_of: Callable[[float, float, float, float, Any], tuple[float, float]],
) -> Callable[..., Form]:
    """Return a function from numbers and arrays to the `Form` of the force with this name.

    force_of(x, y, values) is f at (x, y) [m/s^2], with values the tuple of those numbers and
    arrays. product_of(x, y, w_x, w_y, values) is minus the transposed derivative of f times w;
    of a force with a potential, f = -grad W, that is the Hessian of W times w. Numba compiles
    both.
    """
    # Numba's cache would not notice that they have changed, but it does notice a new type. What it
    # has stored refers to their module by name, and cannot be loaded where that is another one.
    key = f'{force_of.__module__}.{name} {_digest(force_of, product_of)}'
    compiled_force, compiled_product = inlined(force_of), inlined(product_of)

    @overload(_force, jit_options=_COMPILED)
    def _choose_force(x, y, form):  # type: ignore[no-untyped-def]  # Numba compares annotations
        if _is(form, key):
            return lambda x, y, form: compiled_force(x, y, form.values)
        return None

    @overload(_product, jit_options=_COMPILED)
    def _choose_product(x, y, w_x, w_y, form):  # type: ignore[no-untyped-def]
        if _is(form, key):
            return lambda x, y, w_x, w_y, form: compiled_product(x, y, w_x, w_y, form.values)
        return None

    # All forms share it: Numba knows it again by its address, and asks no Python code at a call.
    kind = np.empty(0, [(key, np.bool_)])
    return lambda *values: Form(kind, values)


def _digest(*functions: Any) -> str:
    """Return a number that changes with the file that the functions stand in."""
    try:
        source = inspect.getsource(inspect.getmodule(functions[0]))  # type: ignore[arg-type]
    except (OSError, TypeError):  # typed into an interpreter
        source = str([(each.__code__.co_code, each.__code__.co_consts) for each in functions])
    return sha256(source.encode()).hexdigest()[:16]


def _is(form: types.Type, key: str) -> bool:
    """Return whether this is the type of the forms with a key."""
    return isinstance(form, types.NamedTuple) and form.types[0].dtype.fields.keys() == {key}


def _force(x: float, y: float, form: Form) -> tuple[float, float]:
    raise NotImplementedError('must be called from compiled code')


def _product(x: float, y: float, w_x: float, w_y: float, form: Form) -> tuple[float, float]:
    raise NotImplementedError('must be called from compiled code')


def add_external_forces(ax: Array, ay: Array, x: Array, y: Array, form: ExternalForm) -> None:
    """Add the force on each sheep to its acceleration; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


def add_external_products(h: Array, x: Array, mu: Array, form: ExternalForm) -> None:
    """Add to h the product of each sheep with its mu, all [2, lanes]; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


def add_external_products_of_sweeps(
    h: Array, x: Array, mu: Array, n: int, sweeps: int, form: ExternalForm
) -> None:
    """Do so for several mu of each of n sheep, side by side in mu and h; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


@overload(add_external_forces, jit_options=_COMPILED)
def _add_forces(ax, ay, x, y, form):  # type: ignore[no-untyped-def]
    def add(ax, ay, x, y, form):  # type: ignore[no-untyped-def]
        for i in range(x.shape[0]):
            fx, fy = _force(x[i], y[i], form)
            ax[i] += fx
            ay[i] += fy

    return add if isinstance(form, types.NamedTuple) else lambda ax, ay, x, y, form: None


@overload(add_external_products, jit_options=_COMPILED)
def _add_products(h, x, mu, form):  # type: ignore[no-untyped-def]
    def add(h, x, mu, form):  # type: ignore[no-untyped-def]
        for i in range(x.shape[1]):
            px, py = _product(x[0, i], x[1, i], mu[0, i], mu[1, i], form)
            h[0, i] += px
            h[1, i] += py

    return add if isinstance(form, types.NamedTuple) else lambda h, x, mu, form: None


@overload(add_external_products_of_sweeps, jit_options=_COMPILED)
def _add_products_of_sweeps(h, x, mu, n, sweeps, form):  # type: ignore[no-untyped-def]
    def add(h, x, mu, n, sweeps, form):  # type: ignore[no-untyped-def]
        for i in range(n):
            for k in range(i * sweeps, (i + 1) * sweeps):
                px, py = _product(x[0, i], x[1, i], mu[0, k], mu[1, k], form)
                h[0, k] += px
                h[1, k] += py

    return add if isinstance(form, types.NamedTuple) else lambda h, x, mu, n, sweeps, form: None
