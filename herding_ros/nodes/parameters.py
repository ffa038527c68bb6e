"""Dataclasses of parameters <-> ROS parameters."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
import dataclasses
import sys
import time
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from herding_ros.model.parameters import check, describe_limits, Parameters

from .refusals import Refusals, Refused

_P = TypeVar('_P', bound=Parameters)


class HerdingNode(Node):
    """A node whose parameters and services take nothing that they should not.

    Sim, controller and recorder are of this kind.
    """

    _followed: tuple[tuple[str, Parameters], ...] = ()
    _take: Callable[..., None]

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._refused = Refusals(self.get_logger())
        self.joined = time.monotonic()
        """When other nodes could begin to be found [s]."""
        descriptor = ParameterDescriptor(
            description='whether time is that of /clock, not of the system',
            type=ParameterType.PARAMETER_BOOL,
            read_only=True,
        )
        self.set_descriptor('use_sim_time', descriptor)

    def load_kernels(self, warm_up: Callable[[], float]) -> None:
        """Make compiled kernels ready; it may take half a minute the first time."""
        self.get_logger().info('loading kernels, which are compiled the first time')
        self.get_logger().info(f'kernels loaded in {warm_up():.1f} s')

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **options: Any
    ) -> Subscription:
        """Subscribe as any node does; but a time that is none does not reach rclpy's clock.

        It would raise ValueError in the executor, and the node would end.
        """
        if msg_type is not Clock:
            return super().create_subscription(msg_type, topic, callback, *args, **options)

        def take(message: Clock) -> None:
            try:
                callback(message)
            except (ValueError, OverflowError) as error:
                self._refused.add(topic, Refused('no time', str(error)))

        return super().create_subscription(msg_type, topic, take, *args, **options)

    def follow(
        self, declared: Sequence[tuple[str, Parameters]], take: Callable[..., None]
    ) -> None:
        """Call take(values, ...) whenever somebody has set live parameters.

        `declared` pairs a prefix with what `declare` returned for it; take gets a new one of
        each, in the same order. What one of them does not allow is refused with its reason.
        """
        self._followed = tuple(declared)
        self._take = take

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all or none; the parameter services come here."""
        changes = {p.name: p.value for p in parameter_list}
        try:
            for name in changes:
                if not self.has_parameter(name):
                    raise ValueError(f'{self.get_name()} has no parameter {name}')
            live = {name: value for name, value in changes.items() if self._is_live(name)}
            new = [(prefix, _changed(old, live, prefix)) for prefix, old in self._followed]
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        result = super().set_parameters_atomically(parameter_list)
        if result.successful and live:
            self._followed = tuple(new)
            self._take(*(values for _, values in new))
        return result

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any
    ) -> Service:
        """Create a service, one of rclpy's own included, that no request can end the node with."""

        def answer(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except ValueError as error:
                self.get_logger().warning(f'{srv_name}: a request makes no sense: {error}')
                return response

        return super().create_service(srv_type, srv_name, answer, **options)

    def stop(self) -> None:
        """Let what takes long end early; called in a thread of its own when the node shall end."""

    def _is_live(self, name: str) -> bool:
        return not self.describe_parameter(name).read_only


def declare(node: Node, defaults: _P, prefix: str = '', live: Sequence[str] = ()) -> _P:
    """Declare every field of `defaults` as a parameter and return them with the values set.

    Nested dataclasses become dotted names. Those whose name is in `live`, or begins with an
    entry of it that ends with a dot, may change while the node runs, see `HerdingNode.follow`.
    Raises ValueError naming parameter, value and what is allowed.
    """
    values: dict[str, Any] = {}
    for field in dataclasses.fields(defaults):
        default, name = getattr(defaults, field.name), prefix + field.name
        if isinstance(default, Parameters):
            values[field.name] = declare(node, default, f'{name}.', live)
        else:
            groups = tuple(entry for entry in live if entry.endswith('.'))
            is_live = name in live or name.startswith(groups)
            values[field.name] = _declare_field(node, name, default, field, is_live)
    try:
        return dataclasses.replace(defaults, **values)
    except ValueError as error:
        raise ValueError(f'parameters {prefix or "of the node"}: {error}') from error


def _declare_field(
    node: Node, name: str, default: Any, field: dataclasses.Field[Any], is_live: bool
) -> Any:
    unit = field.metadata['unit']
    descriptor = ParameterDescriptor(
        description=field.metadata['doc'] + (f' [{unit}]' if unit else ''),
        additional_constraints=describe_limits(field),
        read_only=not is_live,
        **_range(field),
    )
    initial = list(default) if isinstance(default, tuple) else default
    try:
        value = node.declare_parameter(name, initial, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        _checked(name, node._parameter_overrides[name].value, field)
        raise ValueError(str(error)) from error
    return _checked(name, value, field)


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


def _changed(values: _P, changes: dict[str, Any], prefix: str) -> _P:
    """Return the values with those of some full names changed; ValueError if not allowed."""
    new: dict[str, Any] = {}
    for field in dataclasses.fields(values):
        value, name = getattr(values, field.name), prefix + field.name
        if isinstance(value, Parameters):
            new[field.name] = _changed(value, changes, f'{name}.')
        elif name in changes:
            new[field.name] = _checked(name, changes[name], field)
    return dataclasses.replace(values, **new)


def _checked(name: str, value: Any, field: dataclasses.Field[Any]) -> Any:
    """Return value as the field's type; ValueError if it is not allowed, or 1 instead of 1.0."""
    given = list(value) if isinstance(value, array) else value
    numbers = given if isinstance(given, list) else [given]
    like = field.default[0] if isinstance(field.default, tuple) else field.default
    if type(like) is float and numbers and all(type(number) is int for number in numbers):
        with_points = [float(number) for number in numbers]
        raise ValueError(
            f'parameter {name} is {given!r}, allowed is {describe_limits(field)}; '
            f'write {with_points if isinstance(given, list) else with_points[0]!r}'
        )
    return check(f'parameter {name}', given, field)
