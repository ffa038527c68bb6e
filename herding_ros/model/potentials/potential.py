# SPDX-License-Identifier: Apache-2.0
"""What a potential provides, and its table for the kernels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields
from functools import cache
import math
from typing import TYPE_CHECKING, TypeVar

from herding_ros.model.parameters import Parameters
from herding_ros.model.state import Array
import numpy as np

if TYPE_CHECKING:
    from .forms import PotentialForm, Table

_P = TypeVar('_P', bound='Potential')

_NEAREST, _FARTHEST = 5e-7, 1e6
"""A table covers distances between these multiples of the extent; P'/r is constant outside."""


class Potential(Parameters, ABC):
    """A radially symmetric potential P(r) [m^2/s^2] of two at a distance r [m].

    Positive slopes attract, negative ones repel. A new one is a frozen dataclass with these three
    methods, each from an array of any shape, r > 0, to one of the same shape. Its fields must be
    hashable: tuples, no arrays. The paper asks for bounded and locally Lipschitz first and second
    derivatives. A potential that ends at some distance has a `reach`, where its second derivative
    may jump. Its numbers are quantities with units, so that it can be `rescaled`, and its lengths
    tell its `extent`. Raises TypeError if one of the methods is missing.
    """

    @abstractmethod
    def value(self, r: Array) -> Array:
        """P(r) [m^2/s^2]."""

    @abstractmethod
    def derivative(self, r: Array) -> Array:
        """P'(r) [m/s^2]."""

    @abstractmethod
    def second_derivative(self, r: Array) -> Array:
        """P''(r) [1/s^2]."""

    def rescaled(self: _P, length: float, time: float) -> _P:
        """See `Parameters`; ValueError for one without fields, whose numbers nobody knows."""
        if not fields(self):
            raise ValueError(
                f'{type(self).__name__} must have fields, whose units are known, to be rescaled'
            )
        return super().rescaled(length, time)

    @property
    def reach(self) -> float:
        """Distance [m] from which on there is no force; infinite unless a potential says it."""
        return math.inf

    @property
    def extent(self) -> float:
        """The longest of its lengths [m], in which tables are made; 1 m if it states none."""
        lengths = [each.value for each in self.walk() if each.field.metadata['unit'] == 'm']
        return max(lengths, default=1.0)

    @property
    def nearest(self) -> float:
        """Distance [m] within which a table takes P'/r for constant, if its reach is longer."""
        return _NEAREST * self.extent

    def kernel_form(self) -> PotentialForm:
        """Return the form for the kernels: a table, unless a potential overrides it.

        Raises ValueError if a derivative is not finite everywhere in its range, and for a reach
        that is not above 0.
        """
        return _table(self)

    def without_ranges_below(self, length: float) -> Potential:
        """Return the potential without parts of a shorter range [m], if it has such parts."""
        return self


@cache
def _table(potential: Potential) -> Table:
    """Tabulate P'/r by cubic pieces in z = r**2 / unit**2, with the derivative in z at the nodes.

    Nodes stand closer where r is small, at a fixed relative distance: 128 from one power of
    two to the next. The error falls with its fourth power: 1e-9 relative for P' like r**-1.
    The unit is the finite reach, else the extent. At a reach stands a node, z = 1, the piece
    before it has the derivatives on its own side, and the last one, beyond, is zero.
    """
    from . import forms  # a program's help needs no Numba

    if not potential.reach > 0.0:
        name = f'{type(potential).__name__}.reach'
        raise ValueError(f'{name} must be above 0, got {potential.reach!r}')
    ends = math.isfinite(potential.reach)
    unit = potential.reach if ends else potential.extent
    near, far = potential.nearest / unit, _FARTHEST
    if ends:
        near, far = min(near, 1e-3), 1.0
    nodes = forms.table_nodes(near**2, far**2)
    r = np.minimum(unit * np.sqrt(nodes), np.nextafter(potential.reach, 0.0))
    a = potential.derivative(r) / r
    slope = (potential.second_derivative(r) - a) / (2.0 * nodes)
    for name, values in (('derivative', a), ('second_derivative', slope)):
        if not np.isfinite(values).all():
            raise ValueError(
                f'{type(potential).__name__}.{name} must be finite at all distances, got '
                f'{values[~np.isfinite(values)][0]:g} at {r[~np.isfinite(values)][0]:g}'
            )
    form = forms.table(nodes, a, slope, 1.0 / unit**2)
    if ends:
        for coefficient in (form.c0, form.c1, form.c2, form.c3):
            coefficient[-1] = 0.0
    return form
