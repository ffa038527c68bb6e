# SPDX-License-Identifier: Apache-2.0
"""Alignment: each sheep takes on the velocities of those around it (Cucker and Smale 2007).

    v_i' = ... + beta/N sum_j w(|x_i - x_j|) (v_j - v_i),    w(r) = exp(-r^2 / (2 l^2))

with rate beta and range l. The sum is divided by N, as that of the pair forces, and not by the
number of neighbours (Motsch and Tadmor 2011). So what a sheep gains another loses: alignment does
not move the flock's centre, and it has a limit for many sheep (Ha and Tadmor 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

from .parameters import Parameters, quantity, TINY

AlignmentForm = tuple[float, float]
"""In compiled code: beta / N [1/s] and 1 / (2 l^2) [1/m^2]."""


@dataclass(frozen=True)
class Alignment(Parameters):
    """How fast and how far sheep align; by default they do not."""

    rate: float = quantity(
        0.0,
        'rate at which a sheep takes on the mean velocity of a flock that is within the range',
        '1/s',
        low=0.0,
    )
    range: float = quantity(
        1.0, 'standard deviation of the weight of another sheep by its distance', 'm', low=TINY
    )

    def kernel_form(self, n: int) -> AlignmentForm:
        """Return what the kernels need for n sheep."""
        return self.rate / n, 0.5 / self.range**2
