"""Dataclasses of parameters <-> ROS parameters."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from herding_ros.model.parameters import (
    check,
    Crowd,
    CROWDS,
    describe_limits,
    Parameters,
    quantity,
)
from herding_ros.model.scenario import GOAL


@dataclasses.dataclass(frozen=True)
class NodeSettings(Parameters):
    """What sim and controller have in common as ROS nodes."""

    goal: tuple[float, float] = quantity(GOAL, 'destination; goal_pose moves it', 'm')
    frame: str = quantity('map', 'frame of all positions')
    lockstep: bool = quantity(
        False,
        'the sim waits at each control period for the commands that answer its state, '
        'which the controller stamps as the state is stamped',
    )
    stamped: bool = quantity(True, 'commands are TwistStamped; false: Twist')
    wait_for: str = quantity('', 'name of a node (a recorder) that must hear everything first')

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        if self.lockstep and not self.stamped:
            raise ValueError('lockstep needs stamped commands: set stamped to true')


_P = TypeVar('_P', bound=Parameters)
_UNBOUNDED = 1e9


def declare(node: Node, defaults: _P, prefix: str = '') -> _P:
    """Declare every field of `defaults` as a parameter and return them with the values set.

    Nested dataclasses become dotted names. Raises ValueError naming parameter, value and what
    is allowed.
    """
    values: dict[str, Any] = {}
    for field in dataclasses.fields(defaults):
        default = getattr(defaults, field.name)
        if isinstance(default, Parameters):
            values[field.name] = declare(node, default, f'{prefix}{field.name}.')
        else:
            values[field.name] = _declare_field(node, prefix + field.name, default, field)
    try:
        return dataclasses.replace(defaults, **values)
    except ValueError as error:
        raise ValueError(f'parameters {prefix or "of the node"}: {error}') from error


@dataclasses.dataclass(frozen=True)
class _Preset(Parameters):
    preset: str = quantity(
        'cohesive', 'where the defaults of crowd.* come from', choices=tuple(CROWDS)
    )


def declare_crowd(node: Node) -> Crowd:
    """Declare the crowd: `crowd.preset` gives the defaults of the other `crowd.` parameters."""
    (choice,) = dataclasses.fields(_Preset)
    preset = _declare_field(node, 'crowd.preset', choice.default, choice)
    return declare(node, CROWDS[preset], 'crowd.')


def _declare_field(node: Node, name: str, default: Any, field: dataclasses.Field[Any]) -> Any:
    unit = field.metadata['unit']
    descriptor = ParameterDescriptor(
        description=field.metadata['doc'] + (f' [{unit}]' if unit not in ('', '1') else ''),
        additional_constraints=describe_limits(field),
        read_only=True,
    )
    low, high = field.metadata['low'], field.metadata['high']
    top = _UNBOUNDED if high is None else high
    if low is not None and type(default) is int:
        integers = IntegerRange(from_value=int(low), to_value=int(top), step=0)
        descriptor.integer_range = [integers]
    if low is not None and type(default) is float:
        floats = FloatingPointRange(from_value=float(low), to_value=float(top), step=0.0)
        descriptor.floating_point_range = [floats]
    initial = list(default) if isinstance(default, tuple) else default
    try:
        value = node.declare_parameter(name, initial, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        given = node._parameter_overrides[name].value
        hint = f'; write {given:.1f}' if type(default) is float and type(given) is int else ''
        raise ValueError(
            f'parameter {name} is {given!r}, allowed is {describe_limits(field)}{hint}'
        ) from error
    return check(f'parameter {name}', value, field)
