# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
import dataclasses
import math
import re
from typing import Any

from herding_ros.model.crowd import Crowd, CROWDS
from herding_ros.model.external_form import NoForce
from herding_ros.model.motion import Unicycle
from herding_ros.model.noise_field import NoiseField
from herding_ros.model.parameters import Parameters, quantity
from herding_ros.model.potentials import Morse
from herding_ros.model.simulation import World
import numpy as np
import pytest


@dataclasses.dataclass(frozen=True)
class Sample(Parameters):
    number: float = quantity(1.0, 'a number', low=0.0, high=2.0)
    at_most: float = quantity(1.0, 'a number', high=2.0)
    count: int = quantity(1, 'an integer', low=1)
    flag: bool = quantity(True, 'a switch')
    text: str = quantity('a', 'a string')
    choice: str = quantity('a', 'a choice', choices=('a', 'b'))
    pair: tuple[float, float] = quantity((0.0, 0.0), 'two numbers', low=-1.0)


REFUSED = [
    ('number', '1', 'a number from 0 to 2'),
    ('number', True, 'a number from 0 to 2'),
    ('number', None, 'a number from 0 to 2'),
    ('number', math.nan, 'a number from 0 to 2'),
    ('number', 2.0000001, 'from 0 to 2'),
    ('number', -1e-300, 'from 0 to 2'),
    ('at_most', 2.5, 'from -1e+09 to 2'),
    ('at_most', -math.inf, 'a number from -1e+09 to 2'),
    ('count', 0, 'at least 1'),
    ('count', 1.0, 'an integer of at least 1'),
    ('count', True, 'an integer of at least 1'),
    ('count', np.float64(1.0), 'an integer of at least 1'),
    ('count', np.True_, 'an integer of at least 1'),
    ('number', np.True_, 'a number from 0 to 2'),
    ('flag', np.int64(1), 'true or false'),
    ('flag', 1, 'true or false'),
    ('text', 1, 'a string'),
    ('choice', 'c', 'a or b'),
    ('choice', True, 'a or b'),
    ('pair', (1.0,), '2 numbers from -1 to 1e+09'),
    ('pair', (1.0, math.nan), '2 numbers from -1 to 1e+09'),
    ('pair', (1.0, -2.0), '2 numbers from -1 to 1e+09'),
    ('pair', 1.0, '2 numbers from -1 to 1e+09'),
    ('pair', '12', '2 numbers from -1 to 1e+09'),
    ('pair', ('1', '2'), '2 numbers from -1 to 1e+09'),
]


@pytest.mark.parametrize(('name', 'value', 'allowed'), REFUSED)
def test_refusal_names_field_what_it_must_be_and_what_was_given(
    name: str, value: object, allowed: str
) -> None:
    message = re.escape(f'Sample.{name} must be {allowed}, got {value!r}')
    with pytest.raises(ValueError, match=f'^{message}$'):
        Sample(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('name', 'value', 'kept'),
    [('number', 0, 0.0), ('number', 2.0, 2.0), ('pair', [1, 2], (1.0, 2.0)), ('choice', 'b', 'b')],
)
def test_bounds_are_inclusive_and_integers_pass_as_numbers(
    name: str, value: Any, kept: Any
) -> None:
    found = getattr(Sample(**{name: value}), name)
    assert found == kept
    assert type(found) is type(kept)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('number', np.float32(0.5)),
        ('number', np.int64(2)),
        ('count', np.int64(3)),
        ('count', np.uint8(3)),
        ('flag', np.False_),
        ('text', np.str_('b')),
        ('choice', np.str_('b')),
        ('pair', np.arange(2)),
    ],
)
def test_scalars_of_numpy_pass_as_those_of_python(name: str, value: Any) -> None:
    found = getattr(Sample(**{name: value}), name)
    assert type(found) is type(getattr(Sample(), name))
    np.testing.assert_array_equal(found, value)


@pytest.mark.parametrize(
    ('make', 'named'),
    [
        (lambda: Morse(repulsion_length=0.0), 'Morse.repulsion_length is 0.0'),
        (lambda: Morse(attraction=-5e-4), 'Morse.attraction is -0.0005'),
        (lambda: Crowd(friction=math.nan), 'Crowd.friction is nan'),
        (lambda: Crowd(noise=-0.01), 'Crowd.noise is -0.01'),
        (lambda: World(sheep=0), 'World.sheep is 0'),
        (lambda: World(dogs=2.0), 'World.dogs is 2.0'),
        (lambda: World(dt=0.0), 'World.dt is 0.0'),
        (lambda: World(seed=-1), 'World.seed is -1'),
    ],
)
def test_every_set_of_parameters_is_validated(make: Callable[[], object], named: str) -> None:
    name, value = map(re.escape, named.split(' is '))
    with pytest.raises(ValueError, match=f'^{name} must be .*, got {value}$'):
        make()


def test_groups_within_parameters_are_validated() -> None:
    with pytest.raises(ValueError, match=r'^Crowd\.sheep must be a Potential, got 3$'):
        Crowd(sheep=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r'^World\.arrival must be an Arrival, got 0\.1$'):
        World(arrival=0.1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('make', 'name', 'kind'),
    [
        (lambda: World(motion=Unicycle), 'World.motion', 'a MotionModel'),  # type: ignore
        (lambda: Crowd(noise_field=NoiseField), 'Crowd.noise_field', 'a NoiseFunction'),
        (lambda: Crowd(external=NoForce), 'Crowd.external', 'an ExternalForce'),  # type: ignore
    ],
)
def test_a_class_is_none_of_its_objects(make: Callable[[], object], name: str, kind: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(name)} must be {kind}, got <class '.*'>$"):
        make()


EVERYWHERE_ALIKE = Crowd(noise_field=lambda t, x: 1.0)  # a field without parameters


@dataclasses.dataclass(frozen=True)
class Nested(Parameters):
    sample: Sample = Sample()
    crowd: Crowd = EVERYWHERE_ALIKE
    last: float = quantity(3.0, 'a number')


def test_nested_values_have_dotted_names() -> None:
    flat = Nested().flat('of.')
    assert list(flat)[:2] == ['of.sample.number', 'of.sample.at_most']
    assert flat['of.crowd.sheep.attraction'] == Crowd().sheep.attraction  # type: ignore[attr-defined]
    assert not any('noise_field' in name for name in flat)
    assert flat['of.last'] == 3.0


def test_values_are_replaced_together() -> None:
    changes = {'of.sample.count': 4, 'of.last': 2, 'of.crowd.noise': 0.5}
    new = Nested().with_values(changes, 'of.')
    assert {n: v for n, v in new.flat('of.').items() if v != Nested().flat('of.')[n]} == changes
    assert new.crowd.noise_field is Nested().crowd.noise_field
    with pytest.raises(ValueError, match=r'^Sample\.count must be at least 1, got 0$'):
        Nested().with_values({'sample.count': 0})
    with pytest.raises(ValueError, match=r'^Nested has no parameter last, sample\.cuont$'):
        Nested().with_values({'of.sample.count': 1, 'sample.cuont': 1, 'last': 1}, 'of.')


@pytest.mark.parametrize('group', [Morse, Crowd, World])
def test_every_field_is_explained(group: type[Parameters]) -> None:
    for field in dataclasses.fields(group):
        assert field.metadata.get('doc') or isinstance(field.default, Parameters)


def test_presets_are_the_paper_with_and_without_the_lengths_swapped() -> None:
    printed, cohesive = CROWDS['printed'], CROWDS['cohesive']
    assert printed.sheep == Morse(1.0, 2.0, 5e-4, 1e-2)
    assert printed.dog == Morse(1e-2, 0.5, 5e-4, 1e-2)
    assert cohesive.sheep == Morse(1.0, 1e-2, 5e-4, 2.0)
    assert cohesive.dog == Morse(1e-2, 0.5, 5e-4, 2.0)
    assert cohesive == Crowd()
    assert {crowd.friction for crowd in (printed, cohesive)} == {0.5}


def test_guides_attract_without_a_jerk() -> None:
    """The force vanishes at the guide, and its Hessian is bounded there; it pulls elsewhere."""
    guide = CROWDS['guided'].dog
    near, everywhere = np.array([1e-6, 1e-4]), np.geomspace(1e-3, 10.0, 200)
    assert (guide.derivative(everywhere) > 0.0).all()
    np.testing.assert_allclose(guide.derivative(near) / near, 0.18, rtol=1e-3)
    np.testing.assert_allclose(guide.second_derivative(near), 0.18, rtol=1e-2)


def test_coefficients_are_those_of_the_derivative() -> None:
    assert Morse(3.0, 0.5, 8.0, 4.0).coefficients == (6.0, 2.0, 2.0, 0.25)
