# SPDX-License-Identifier: Apache-2.0
from collections.abc import Iterator
import dataclasses
from dataclasses import dataclass
import re

from herding_ros.control.parameters import CONTROLS
from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.dynamics import forces
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.parameters import Parameters
from herding_ros.model.potentials import Harmonic, Mollified, Morse, Potential, PowerLaw, Tabulated
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
from herding_ros.model.units import factor
import numpy as np
import pytest

GROUPS: list[Parameters] = [World(), *CONTROLS.values(), *CROWDS.values(), NoiseField()]
TABULATED = Tabulated((0.01, 0.1, 0.3, 1.0), (0.02, 0.01, 0.004, 0.0))
POTENTIALS = [Morse(), Harmonic(), PowerLaw(), TABULATED, Mollified(Morse(), 0.05)]


@pytest.mark.parametrize(
    ('unit', 'expected'),
    [
        ('', 1.0), ('m', 3.0), ('s', 5.0), ('rad', 1.0), ('byte', 1.0), ('1/m', 1.0 / 3.0),
        ('m/s', 3.0 / 5.0), ('s^2', 25.0), ('m^2/s^2', 9.0 / 25.0), ('1/s^2', 1.0 / 25.0),
        ('m/s^1.5', 3.0 / 5.0**1.5), ('m/s^0.5', 3.0 / 5.0**0.5),
    ],
)  # fmt: skip
def test_factor_is_the_unit_with_numbers_in_it(unit: str, expected: float) -> None:
    assert factor(unit, 3.0, 5.0) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize('unit', ['kg', 'm s', 'm^', '2m', 'm//s', 'm^x'])
def test_what_is_not_a_unit_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f'such as m, 1/s or m/s^1.5, got {unit!r}')):
        factor(unit, 2.0, 2.0)


@pytest.mark.parametrize('group', GROUPS)
def test_every_value_changes_by_its_unit_and_changes_back(group: Parameters) -> None:
    there = group.rescaled(40.0, 1.0 / 60.0)
    seen = 0
    for before, after in zip(group.walk(), there.walk(), strict=True):
        unit = before.field.metadata['unit']
        if not unit:
            assert after.value == before.value
            continue
        np.testing.assert_allclose(
            after.value, np.array(before.value) * factor(unit, 40.0, 1.0 / 60.0), rtol=1e-15
        )
        seen += 1
    assert seen
    back = there.rescaled(1.0 / 40.0, 60.0)
    for before, after in zip(group.walk(), back.walk(), strict=True):
        if before.field.metadata['unit']:
            np.testing.assert_allclose(after.value, before.value, rtol=1e-14)


def named_units(group: Parameters) -> Iterator[tuple[str, str]]:
    for entry in group.walk():
        for written in re.findall(r'\[([^]]*)\]', entry.field.metadata['doc']):
            yield entry.name, written


@pytest.mark.parametrize('group', GROUPS)
def test_no_value_has_another_unit_than_it_declares(group: Parameters) -> None:
    """A number whose unit depends on something could not be converted."""
    assert not list(named_units(group))


@pytest.mark.parametrize('potential', POTENTIALS)
def test_potentials_scale_as_their_units_say(potential: Potential) -> None:
    """P is a square of a speed: P(L r) = (L/T)^2 P(r) where lengths are L, times T times as long.

    A wrong unit of a single parameter would break this.
    """
    length, time, r = 40.0, 1.0 / 60.0, np.geomspace(1e-3, 3.0, 40)
    there = potential.rescaled(length, time)
    for name, unit in (
        ('value', 'm^2/s^2'), ('derivative', 'm/s^2'), ('second_derivative', '1/s^2'),
    ):  # fmt: skip
        here = getattr(potential, name)(r)
        np.testing.assert_allclose(
            getattr(there, name)(length * r),
            factor(unit, length, time) * here,
            rtol=1e-12,
            atol=1e-12 * factor(unit, length, time) * np.abs(here).max(),
        )
    for name in ('extent', 'reach'):
        assert getattr(there, name) == pytest.approx(length * getattr(potential, name), rel=1e-15)


@pytest.mark.parametrize(
    ('potential', 'sheep'), [*((each, 12) for each in POTENTIALS), (Morse(), 1500)]
)
def test_forces_scale_as_accelerations(potential: Potential, sheep: int) -> None:
    """By formula, by table and, with many sheep, by mesh: to rounding, whatever their accuracy."""
    rng = np.random.default_rng(0)
    x, d = rng.uniform(-0.6, 0.6, (sheep, 2)), rng.uniform(-0.6, 0.6, (2, 2))
    crowd = Crowd(sheep=potential, dog=potential)
    length, time = 40.0, 1.0 / 60.0
    here = forces(crowd, x, d)
    there = forces(crowd.rescaled(length, time), length * x, length * d)
    np.testing.assert_allclose(
        there * time**2 / length, here, rtol=0, atol=1e-11 * np.abs(here).max()
    )


def test_users_function_cannot_be_rescaled() -> None:
    crowd = Crowd(noise_field=lambda t, x: 1.0)
    with pytest.raises(ValueError, match=r'Crowd\.noise_field must be made of parameters'):
        crowd.rescaled(2.0, 1.0)


def test_numbers_within_methods_cannot_be_rescaled() -> None:
    class Bare(Potential):
        def value(self, r: Array) -> Array:
            return np.exp(-r)

        def derivative(self, r: Array) -> Array:
            return -np.exp(-r)

        def second_derivative(self, r: Array) -> Array:
            return np.exp(-r)

    with pytest.raises(
        ValueError, match=r'^Bare must have fields, whose units are known, to be re'
    ):
        Crowd(dog=Bare()).rescaled(2.0, 1.0)


def test_integers_stay() -> None:
    world = World(sheep=7, substeps=5).rescaled(10.0, 10.0)
    assert (world.sheep, world.substeps) == (7, 5)


def test_potential_that_states_no_length_is_measured_in_metres() -> None:
    @dataclass(frozen=True)
    class Plain(Harmonic):
        pass

    assert Plain(reach=0.3).extent == 0.3
    assert dataclasses.replace(Morse(), attraction_length=7.0).extent == 7.0
