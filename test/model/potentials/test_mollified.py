# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import dataclass, replace
import math

from herding_ros.model.potentials import (
    forms,
    Harmonic,
    Mollified,
    Morse,
    Potential,
    PowerLaw,
    Tabulated,
)
from herding_ros.model.state import Array
import numpy as np
import pytest


@dataclass(frozen=True)
class Gaussian(Potential):
    """exp(-r^2 / (2 a^2)): its convolution with a Gaussian is known."""

    a: float
    height: float = 1.0

    def __post_init__(self) -> None:
        pass

    def value(self, r: Array) -> Array:
        return self.height * np.exp(-0.5 * (r / self.a) ** 2)

    def derivative(self, r: Array) -> Array:
        return -r / self.a**2 * self.value(r)

    def second_derivative(self, r: Array) -> Array:
        return (r**2 / self.a**4 - 1.0 / self.a**2) * self.value(r)


R = np.geomspace(1e-3, 2.0, 200)
WIDTH = 0.05
ENDING = [Harmonic(3.0, 0.5), Harmonic(3.0, 0.02), Tabulated((0.0, 0.2, 0.5), (3.0, 1.0, 0.7))]
"""Potentials whose second derivative jumps where they end."""


@pytest.mark.parametrize('a', [0.01, 0.05, 0.3])
def test_of_a_gaussian_is_the_wider_gaussian(a: float) -> None:
    wider = math.hypot(a, WIDTH)
    exact = Gaussian(wider, (a / wider) ** 2)
    found = Mollified(Gaussian(a), WIDTH)
    for name in ('value', 'derivative', 'second_derivative'):
        expected = getattr(exact, name)(R)
        scale = abs(expected).max()
        np.testing.assert_allclose(getattr(found, name)(R), expected, rtol=0, atol=2e-6 * scale)


def convolution(p: Potential, width: float, r: float) -> float:
    """Sum over a polar grid around the potential's own centre, where it may be sharp."""
    x, w = np.polynomial.legendre.leggauss(20)
    edges = np.concatenate([[0.0], np.geomspace(1e-4, r + 9.0 * width, 60)])
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    s = (middle[:, None] + half[:, None] * x).ravel()
    angles = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    squares = r**2 + s[:, None] ** 2 - 2.0 * r * s[:, None] * np.cos(angles)
    blob = np.exp(-squares / (2.0 * width**2)).mean(axis=1) / width**2
    return float((half[:, None] * w).ravel() @ (p.value(s) * s * blob))


@pytest.mark.parametrize('p', [Morse(), PowerLaw(), Morse(1e-2, 0.5, 5e-4, 2.0), *ENDING])
@pytest.mark.parametrize('r', [0.002, 0.03, 0.1, 0.39, 0.41, 1.0])  # the seam is at 0.4
def test_value_is_the_integral_over_the_plane(p: Potential, r: float) -> None:
    found = Mollified(p, WIDTH).value(np.array([r]))[0]
    scale = abs(p.value(np.array([WIDTH]))[0])
    # The reference does not know where a potential ends.
    error = 1e-8 if p.reach == math.inf else 2e-4
    assert found == pytest.approx(convolution(p, WIDTH, r), rel=error, abs=error * scale)


@pytest.mark.parametrize('p', [Morse(), PowerLaw(), *ENDING])
def test_derivatives_are_those_of_the_value(p: Potential) -> None:
    blurred, h = Mollified(p, WIDTH), 1e-4 * R
    slope = (blurred.value(R + h) - blurred.value(R - h)) / (2.0 * h)
    curvature = (blurred.derivative(R + h) - blurred.derivative(R - h)) / (2.0 * h)
    for found, expected in (
        (blurred.derivative(R), slope),
        (blurred.second_derivative(R), curvature),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-7 * abs(expected).max())


def test_short_repulsion_becomes_a_pressure() -> None:
    """2 pi l^2 C times the Gaussian, whose variance gains the 3 l^2 of exp(-r / l)."""
    strength, length, width = 2.0, 1e-3, 0.05
    variance = width**2 + 3.0 * length**2
    found = Mollified(Morse(strength, length, 0.0, 1.0), width).value(R)
    expected = length**2 * strength / variance * np.exp(-(R**2) / (2.0 * variance))  # 2 pi cancels
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * expected.max())


def test_long_range_stays_as_it_is() -> None:
    """P + width^2 / 2 times its Laplacian, and nothing of that order more."""
    p, width = Morse(0.0, 1.0, 1.0, 2.0), 0.02
    r = np.linspace(0.5, 5.0, 50)
    laplacian = p.second_derivative(r) + p.derivative(r) / r
    change = Mollified(p, width).value(r) - p.value(r)
    np.testing.assert_allclose(change, 0.5 * width**2 * laplacian, atol=1e-7)
    assert abs(change).max() > 1e-5


@pytest.mark.parametrize('width', [1e-3, 0.05, 0.5])
def test_table_agrees_with_the_derivatives(width: float) -> None:
    blurred = Mollified(Morse(), width)
    r = np.geomspace(1e-6, 20.0, 3000)
    a, b = forms.pair_terms(r**2, blurred.kernel_form())
    slope, curvature = blurred.derivative(r), blurred.second_derivative(r)
    np.testing.assert_allclose(a * r, slope, rtol=0, atol=2e-5 * abs(slope).max())
    found = a + b * r**2
    np.testing.assert_allclose(found, curvature, rtol=0, atol=1e-3 * abs(curvature).max())
    known = r > blurred.nearest
    scale = abs(slope).max()
    np.testing.assert_allclose((a * r)[known], slope[known], rtol=1e-7, atol=1e-8 * scale)


def test_finite_width_is_needed() -> None:
    with pytest.raises(ValueError, match=r'Mollified.width must be .*, got 0.0'):
        Mollified(Morse(), 0.0)
    with pytest.raises(ValueError, match=r'Mollified.potential must be a Potential, got 3'):
        Mollified(3)  # type: ignore[arg-type]
    assert replace(Mollified(Morse()), width=0.1) == Mollified(Morse(), 0.1)  # one table for both
