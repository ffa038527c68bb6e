# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from dataclasses import dataclass
import re

from herding_ros.model.crowd import Crowd
from herding_ros.model.dynamics import forces
from herding_ros.model.potentials import (
    forms,
    Harmonic,
    Morse,
    Potential,
    PowerLaw,
    Tabulated,
)
from herding_ros.model.state import Array
import numpy as np
import pytest

_R = np.linspace(0.0, 2.0, 60)
POTENTIALS = [
    Morse(1.0, 1e-2, 5e-4, 2.0),
    PowerLaw(),
    PowerLaw(1.0, 6.0, 0.1, 0.5, 0.3),
    Tabulated(_R, 0.1 * np.exp(-3.0 * _R) - 0.05 * np.exp(-_R)),  # type: ignore[arg-type]
    Harmonic(3.0, 0.613),
]
EVERYWHERE = np.geomspace(1e-5, 50.0, 4001)


@dataclass(frozen=True)
class Formula(Morse):
    """A Morse potential whose formula the kernels do not know."""

    def kernel_form(self) -> forms.PotentialForm:
        return Potential.kernel_form(self)


@pytest.mark.parametrize('p', POTENTIALS)
def test_derivatives_are_those_of_the_value(p: Potential) -> None:
    r = np.geomspace(1e-3, 3.0, 300)
    h = 1e-4 * r
    slope = (p.value(r + h) - p.value(r - h)) / (2.0 * h)
    curvature = (p.derivative(r + h) - p.derivative(r - h)) / (2.0 * h)
    np.testing.assert_allclose(p.derivative(r), slope, rtol=1e-5, atol=1e-6 * abs(slope).max())
    # At the knots of a spline the third derivative jumps, at its reach the second one.
    scale, smooth = abs(curvature).max(), abs(r - p.reach) > h
    np.testing.assert_allclose(
        p.second_derivative(r)[smooth], curvature[smooth], rtol=1e-5, atol=2e-3 * scale
    )


@pytest.mark.parametrize(
    'p', [Formula(1.0, 1e-2, 5e-4, 2.0), *POTENTIALS[1:3], Harmonic(3.0, 0.613)]
)
def test_table_agrees_with_the_derivatives(p: Potential) -> None:
    r = EVERYWHERE
    a, b = forms.pair_terms(r**2, p.kernel_form())
    np.testing.assert_allclose(a * r, p.derivative(r), rtol=1e-8, atol=1e-9)
    # A cubic's own derivative is less exact by an order.
    exact = p.second_derivative(r) - p.derivative(r) / r
    np.testing.assert_allclose(b * r**2, exact, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize('p', [Harmonic(3.0, 2.5), Harmonic(0.7, 1e-8), POTENTIALS[3]])
def test_table_ends_where_the_potential_does(p: Potential) -> None:
    """With the second derivative of its own side up to there, and exactly nothing beyond."""
    close = np.geomspace(1e-12, 1e-2, 400)
    inside, beyond = p.reach * (1.0 - close), p.reach * np.append(1.0 + close, [10.0, 1e9])
    a, b = forms.pair_terms(inside**2, p.kernel_form())
    scale = abs(p.derivative(p.reach * np.linspace(0.1, 1.0, 10))).max()
    np.testing.assert_allclose(a * inside, p.derivative(inside), rtol=0, atol=1e-8 * scale)
    found, exact = a + b * inside**2, p.second_derivative(inside)
    assert abs(exact).min() > 1e-5
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-5 * scale / p.reach)
    np.testing.assert_array_equal(forms.pair_terms(beyond**2, p.kernel_form()), 0.0)


def test_table_hessian_is_the_derivative_of_its_slope() -> None:
    form = POTENTIALS[1].kernel_form()
    r2 = np.random.default_rng(0).uniform(1e-4, 4.0, 2000)
    h = 1e-6 * r2
    slopes = [forms.pair_terms(r2 + sign * h, form)[0] for sign in (1.0, -1.0)]
    expected = (slopes[0] - slopes[1]) / h  # twice the derivative
    found = forms.pair_terms(r2, form)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6 * abs(expected).max())


def test_table_ends_without_a_jump() -> None:
    form = POTENTIALS[1].kernel_form()
    a, _ = forms.pair_terms(np.array([0.0, 1e-12, 1e6, 1e9, np.inf]), form)
    assert np.isfinite(a).all()
    assert a[0] == pytest.approx(a[1])
    assert a[2] == pytest.approx(a[4], rel=1e-6)


def test_forces_by_table_are_those_by_formula() -> None:
    rng = np.random.default_rng(1)
    x, d = rng.uniform(-0.4, 0.4, (50, 2)), rng.uniform(-1.0, 1.0, (3, 2))
    by_formula = forces(Crowd(), x, d)
    by_table = forces(Crowd(sheep=Formula(1.0, 1e-2, 5e-4, 2.0)), x, d)
    assert abs(by_table - by_formula).max() < 1e-8 * abs(by_formula).max()


def test_harmonic_is_dropped_where_its_reach_is_within_the_noise() -> None:
    p, x, dog = Harmonic(3.0, 0.5), np.zeros((1, 2)), np.array([[0.3, 0.0]])
    for length, expected in ((0.4, -0.6), (0.5, 0.0)):
        crowd = Crowd(dog=p.without_ranges_below(length))
        assert forces(crowd, x, dog)[0, 0] == pytest.approx(expected, abs=1e-9)


def test_power_law_far_out_is_a_power() -> None:
    law = PowerLaw(2.0, 3.0, 0.0, 1.0, 0.01)
    r = np.array([10.0, 20.0])
    np.testing.assert_allclose(law.value(r), 2.0 * (r / 0.01) ** -3.0, rtol=1e-5)


def test_tabulated_goes_on_with_its_force_inside_and_without_beyond() -> None:
    p = Tabulated((0.5, 1.0, 1.5, 2.0), (3.0, 1.0, 0.2, 0.0))
    inside, beyond = p.derivative(np.array([0.1, 0.4, 0.5])), p.derivative(np.array([2.0, 9.0]))
    assert inside.tolist() == pytest.approx([inside[0]] * 3)
    assert beyond.tolist() == pytest.approx([0.0, 0.0])
    assert p.value(np.array([0.3]))[0] == pytest.approx(3.0 - 0.2 * inside[0])


def test_tabulated_reproduces_the_potential_it_samples() -> None:
    r = np.linspace(0.0, 8.0, 400)
    original = PowerLaw(length=0.3)
    p = Tabulated(r, original.value(r))  # type: ignore[arg-type]
    at = np.linspace(0.05, 4.0, 777)
    np.testing.assert_allclose(p.derivative(at), original.derivative(at), atol=2e-6)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: Tabulated((0.0, 1.0, 1.0), (1.0, 2.0, 3.0)), 'at least two increasing numbers'),
        (lambda: Tabulated((1.0,), (1.0,)), 'at least two increasing numbers'),
        (lambda: Tabulated((0.0, 1.0), (1.0,)), 'Tabulated.values must have shape (2,), got (1,)'),
        (lambda: Tabulated((0.0, np.nan), (1.0, 0.0)), 'Tabulated.distances must be finite'),
        (lambda: PowerLaw(length=0.0), 'PowerLaw.length must be from 1e-09 to 1e+09, got 0.0'),
        (lambda: Crowd(sheep=3), 'Crowd.sheep must be a Potential, got 3'),  # type: ignore
    ],
)
def test_what_makes_no_potential_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


def test_potential_that_is_not_finite_is_refused() -> None:
    @dataclass(frozen=True)
    class Coulomb(Morse):
        def kernel_form(self) -> forms.PotentialForm:
            return Potential.kernel_form(self)

        def derivative(self, r: Array) -> Array:
            return np.where(r < 1e-3, np.nan, -1.0 / r**2)

    with pytest.raises(ValueError, match=r'Coulomb\.derivative must be finite .*, got nan at'):
        forces(Crowd(sheep=Coulomb()), np.eye(2), np.ones((1, 2)))


def test_a_potential_without_one_of_its_methods_is_refused_when_it_is_made() -> None:
    @dataclass(frozen=True)
    class Misspelt(Potential):
        def value(self, r: Array) -> Array:
            return -r

        def derivative(self, r: Array) -> Array:
            return np.full_like(r, -1.0)

        def second_derivate(self, r: Array) -> Array:
            return np.zeros_like(r)

    with pytest.raises(TypeError, match=r"'?second_derivative'?$"):
        Misspelt()  # type: ignore[abstract]


@pytest.mark.parametrize('reach', [0.0, -1.0, np.nan])
def test_a_reach_that_is_none_is_refused(reach: float) -> None:
    kind = type('Short', (Formula,), {'reach': reach})
    with pytest.raises(ValueError, match=rf'^Short\.reach must be above 0, got {reach}$'):
        forces(Crowd(dog=kind()), np.eye(2), np.ones((1, 2)))
