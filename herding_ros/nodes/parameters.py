# SPDX-License-Identifier: Apache-2.0
"""Dataclasses of parameters -> declared ROS parameters."""

from __future__ import annotations

from array import array
import dataclasses
import sys
from typing import Any, TypeVar

from herding_ros.control.parameters import Control, CONTROLS
from herding_ros.control.scale import Scale
from herding_ros.model.crowd import Crowd
from herding_ros.model.field import read_field
from herding_ros.model.parameters import check, describe_limits, Entry, Parameters
from herding_ros.model.simulation import World
from herding_ros.model.state import Array
import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from .settings import ControlPreset, CrowdPreset, MotionKind, NodeSettings

_P = TypeVar('_P', bound=Parameters)
_Herd = TypeVar('_Herd', World, Control)


def declare(node: Node, defaults: _P, prefix: str = '') -> _P:
    """Declare every value of `defaults` as a parameter and return them with the values set.

    Those whose field is `live` are dynamic: see `HerdingNode.follow`. Raises ValueError with the
    parameter, what it must be and what was given.
    """
    return defaults.with_values(
        {entry.name: _declare_entry(node, entry) for entry in defaults.walk(prefix)}, prefix
    )


def declare_crowd(node: Node) -> Crowd:
    """Declare the crowd: `crowd.preset` gives the defaults of the other `crowd.` parameters."""
    return declare(node, declare(node, CrowdPreset(), 'crowd.').crowd, 'crowd.')


def in_field(crowd: Crowd, settings: NodeSettings) -> tuple[Crowd, Array]:
    """Return a crowd in the field of a node, and the destination (2,) [m]: the field's, if any."""
    if not settings.field:
        return crowd, np.array(settings.goal)
    field, _ = read_field(settings.field)
    goal = np.array(settings.goal) if field.place is None else field.place
    return field.around(crowd), goal


def declare_control(node: Node, crowd: Crowd) -> Control:
    """Declare the method of the controller: `preset` gives the defaults of its parameters."""
    return declare_scaled(node, CONTROLS[declare(node, ControlPreset()).preset], crowd)


def declare_scaled(node: Node, reference: _Herd, crowd: Crowd) -> _Herd:
    """Declare what has a `max_speed` of dogs, with defaults that fit that and the crowd.

    `reference` are the defaults in the reference scenario; see `Scale`. Where they are others, the
    log says so. The motion is that of `motion.kind`.
    """
    motion = declare(node, MotionKind(), 'motion.').motion
    reference = dataclasses.replace(reference, motion=motion)
    (limit,) = (entry for entry in reference.walk() if entry.name == 'max_speed')
    speed = _declare_entry(node, limit)
    scale = Scale.of(crowd, speed)
    defaults = scale.apply(reference)
    if scale != Scale(1.0, 1.0):
        node.get_logger().info(
            f'defaults fit the crowd and dogs of {speed:g} m/s: {scale} (doc/parameters.md)'
        )
    others = {
        entry.name: _declare_entry(node, entry)
        for entry in defaults.walk()
        if entry.name != limit.name
    }
    return defaults.with_values({**others, limit.name: speed})


def check_parameter(name: str, value: Any, field: dataclasses.Field[Any]) -> Any:
    """Return value as the field's type; ValueError if it is not allowed, or 1 instead of 1.0."""
    given = list(value) if isinstance(value, array) else value
    numbers = given if isinstance(given, list) else [given]
    like = field.default[0] if isinstance(field.default, tuple) else field.default
    if type(like) is float and numbers and all(type(number) is int for number in numbers):
        with_points = [float(number) for number in numbers]
        raise ValueError(
            f'parameter {name} must be {describe_limits(field)}, got {given!r}; '
            f'write {with_points if isinstance(given, list) else with_points[0]!r}'
        )
    return check(f'parameter {name}', given, field)


def _declare_entry(node: Node, entry: Entry) -> Any:
    name, default, field = entry
    unit = field.metadata['unit']
    descriptor = ParameterDescriptor(
        description=field.metadata['doc'] + (f' [{unit}]' if unit else ''),
        additional_constraints=describe_limits(field),
        read_only=not field.metadata['live'],
        **_range(field),
    )
    initial = list(default) if isinstance(default, tuple) else default
    try:
        value = node.declare_parameter(name, initial, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        check_parameter(name, node._parameter_overrides[name].value, field)
        raise ValueError(str(error)) from error
    return check_parameter(name, value, field)


def _range(field: dataclasses.Field[Any]) -> dict[str, Any]:
    """Return the field's bounds as ROS has them, where a side without one has the largest."""
    low, high = field.metadata['low'], field.metadata['high']
    if low is None and high is None:
        return {}
    if type(field.default) is int:
        low = -(2**63) if low is None else int(low)
        high = 2**63 - 1 if high is None else int(high)
        return {'integer_range': [IntegerRange(from_value=low, to_value=high)]}
    low = -sys.float_info.max if low is None else float(low)
    high = sys.float_info.max if high is None else float(high)
    return {'floating_point_range': [FloatingPointRange(from_value=low, to_value=high)]}
