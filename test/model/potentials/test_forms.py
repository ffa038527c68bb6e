# SPDX-License-Identifier: Apache-2.0
from decimal import Decimal, getcontext
import math

from herding_ros.model.crowd import CROWDS
from herding_ros.model.potentials import forms, Morse
from herding_ros.model.state import Array
import numpy as np
import pytest

PAIRS = [(crowd.sheep, crowd.dog) for crowd in CROWDS.values()]
POTENTIALS = [p for pair in PAIRS for p in pair if isinstance(p, Morse) and p.attraction]
DISTANCES = (1e-4, 3e-3, 1e-2, 0.07, 0.5, 2.0, 9.0)


def potential(r: complex, p: Morse) -> complex:
    repulsion = p.repulsion * np.exp(-r / p.repulsion_length)
    return repulsion - p.attraction * np.exp(-r / p.attraction_length)


def gradient(s: Array, p: Morse) -> Array:
    """Gradient of P(|s|), by the complex step, which has no truncation error to speak of."""
    slope = potential(np.linalg.norm(s) + 1e-40j, p).imag / 1e-40
    return slope * s / np.linalg.norm(s)


def arguments() -> Array:
    """All over the range, and where the argument reduction changes its integer."""
    borders = -(np.arange(1010) + 0.5) * math.log(2.0)
    spread_out = np.random.default_rng(0).uniform(-700.0, 0.0, 2000)
    close_to_zero = -np.logspace(-20, 0, 200)
    everywhere = np.concatenate(
        [borders, np.nextafter(borders, 0.0), spread_out, close_to_zero, [-700.0, 0.0]]
    )
    return everywhere[everywhere >= -700.0]


def test_exp_neg_keeps_the_bound_it_promises() -> None:
    getcontext().prec = 40
    worst = 0.0
    for x in arguments():
        exact = Decimal(float(x)).exp()
        worst = max(worst, abs(float((Decimal(forms.exp_neg(x)) - exact) / exact)))
    assert worst < 4e-16


def test_exp_neg_agrees_with_numpy() -> None:
    x = arguments()
    ours = np.array([forms.exp_neg(each) for each in x])
    np.testing.assert_allclose(ours, np.exp(x), rtol=4e-16 + 2.3e-16)  # ours and one ulp


def test_exp_neg_stays_positive_below_its_range() -> None:
    last = forms.exp_neg(-700.0)
    assert [forms.exp_neg(x) for x in (-700.1, -1e6, -math.inf)] == [last] * 3
    assert last == pytest.approx(math.exp(-700.0), rel=4e-16)


@pytest.mark.parametrize('p', POTENTIALS)
@pytest.mark.parametrize('r', DISTANCES)
def test_slope_is_the_derivative_of_the_potential(p: Morse, r: float) -> None:
    s = r * np.array([0.6, -0.8])
    ours = forms.slope_over_r(s @ s, p.coefficients) * s
    # Where attraction and repulsion cancel, round-off is relative to each of them.
    scale = p.repulsion / p.repulsion_length + p.attraction / p.attraction_length
    np.testing.assert_allclose(ours, gradient(s, p), rtol=1e-13, atol=1e-15 * scale)


@pytest.mark.parametrize('p', POTENTIALS)
@pytest.mark.parametrize('r', DISTANCES)
def test_hessian_is_the_derivative_of_the_gradient(p: Morse, r: float) -> None:
    s, w = r * np.array([0.6, -0.8]), np.array([0.3, 1.1])
    h = 1e-5 * min(r, p.repulsion_length, p.attraction_length)
    expected = (gradient(s + h * w, p) - gradient(s - h * w, p)) / (2.0 * h)
    a, b = forms.hessian(s @ s, p.coefficients)
    scale = (p.repulsion / p.repulsion_length + p.attraction / p.attraction_length) / h
    np.testing.assert_allclose(a * w + b * (s @ w) * s, expected, rtol=1e-8, atol=1e-15 * scale)


@pytest.mark.parametrize('p', POTENTIALS)
def test_forces_at_zero_distance_are_zero(p: Morse) -> None:
    assert forms.slope_over_r(0.0, p.coefficients) == 0.0
    assert forms.hessian(0.0, p.coefficients) == (0.0, 0.0)
