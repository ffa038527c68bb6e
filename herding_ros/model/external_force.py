# SPDX-License-Identifier: Apache-2.0
"""Forces on the sheep from the world, such as a fence's: one file for each.

A new one is a class with `kernel_form`, the NamedTuple that it returns, and two functions of a
sheep's place that are given to `register`. Rollouts, ensembles, adjoints and large flocks take
it from there; kernels are compiled for the form that they meet, and for none to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from numba.extending import overload

from .jit import INLINED, inlined, OPTIONS
from .parameters import Parameters
from .state import Array

ExternalForm = tuple[Any, ...]
"""A NamedTuple of numbers and arrays whose type is registered, or ()."""

_COMPILED: Any = {**OPTIONS, **INLINED}


@runtime_checkable
class ExternalForce(Protocol):
    """A force f(x) on each sheep [m/s^2] that depends on its place x alone."""

    def kernel_form(self) -> ExternalForm:
        """Return what the registered functions need."""


@dataclass(frozen=True)
class NoForce(Parameters):
    """Nothing but sheep and dogs."""

    def kernel_form(self) -> tuple[()]:
        """Return the empty form."""
        return ()


def force(x: float, y: float, form: ExternalForm) -> tuple[float, float]:
    """Return f at (x, y) [m/s^2]; to be called from compiled code."""
    raise NotImplementedError('must be called from compiled code')


def product(x: float, y: float, w_x: float, w_y: float, form: ExternalForm) -> tuple[float, float]:
    """Return minus the transposed derivative of f at (x, y) times w; from compiled code.

    Of a force with potential, f = -grad W, that is the Hessian of W times w.
    """
    raise NotImplementedError('must be called from compiled code')


def register(
    form: type,
    force_of: Callable[[float, float, Any], tuple[float, float]],
    product_of: Callable[[float, float, float, float, Any], tuple[float, float]],
) -> None:
    """Take force_of and product_of, in Python that Numba compiles, for `force` and `product`."""
    compiled_force, compiled_product = inlined(force_of), inlined(product_of)

    @overload(force, jit_options=_COMPILED)
    def _force(x, y, form):  # type: ignore[no-untyped-def]  # Numba compares annotations
        if _is(form):
            return lambda x, y, form: compiled_force(x, y, form)
        return None

    @overload(product, jit_options=_COMPILED)
    def _product(x, y, w_x, w_y, form):  # type: ignore[no-untyped-def]
        if _is(form):
            return lambda x, y, w_x, w_y, form: compiled_product(x, y, w_x, w_y, form)
        return None

    def _is(given: Any) -> bool:
        return getattr(given, 'instance_class', None) is form


def add_external_forces(ax: Array, ay: Array, x: Array, y: Array, form: ExternalForm) -> None:
    """Add the force on each sheep to its acceleration; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


def add_external_products(
    hx: Array, hy: Array, x: Array, y: Array, mu_x: Array, mu_y: Array, form: ExternalForm
) -> None:
    """Add `product` of each sheep and its mu to h; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


def add_external_products_of_sweeps(
    hx: Array, hy: Array, x: Array, y: Array, mu_x: Array, mu_y: Array, sweeps: int,
    form: ExternalForm,
) -> None:  # fmt: skip
    """Do so for several mu of each sheep, side by side in mu and h; from compiled code."""
    raise NotImplementedError('must be called from compiled code')


@overload(add_external_forces, jit_options=_COMPILED)
def _add_forces(ax, ay, x, y, form):  # type: ignore[no-untyped-def]
    def add(ax, ay, x, y, form):  # type: ignore[no-untyped-def]
        for i in range(x.shape[0]):
            fx, fy = force(x[i], y[i], form)
            ax[i] += fx
            ay[i] += fy

    return add if len(form) else lambda ax, ay, x, y, form: None


@overload(add_external_products, jit_options=_COMPILED)
def _add_products(hx, hy, x, y, mu_x, mu_y, form):  # type: ignore[no-untyped-def]
    def add(hx, hy, x, y, mu_x, mu_y, form):  # type: ignore[no-untyped-def]
        for i in range(x.shape[0]):
            px, py = product(x[i], y[i], mu_x[i], mu_y[i], form)
            hx[i] += px
            hy[i] += py

    return add if len(form) else lambda hx, hy, x, y, mu_x, mu_y, form: None


@overload(add_external_products_of_sweeps, jit_options=_COMPILED)
def _add_products_of_sweeps(hx, hy, x, y, mu_x, mu_y, sweeps, form):  # type: ignore[no-untyped-def]
    def add(hx, hy, x, y, mu_x, mu_y, sweeps, form):  # type: ignore[no-untyped-def]
        for i in range(x.shape[0]):
            for k in range(i * sweeps, (i + 1) * sweeps):
                px, py = product(x[i], y[i], mu_x[k], mu_y[k], form)
                hx[k] += px
                hy[k] += py

    return add if len(form) else lambda hx, hy, x, y, mu_x, mu_y, sweeps, form: None
