# SPDX-License-Identifier: Apache-2.0
"""The base of sim, controller and recorder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
import time
from typing import Any

from herding_ros.model.parameters import Parameters
from rcl_interfaces.msg import ParameterDescriptor, ParameterType, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rosgraph_msgs.msg import Clock

from .parameters import check_parameter
from .refusals import Refusals, Refused


class HerdingNode(Node):
    """A node that no parameter, service request or time from outside can end."""

    _followed: tuple[tuple[str, Parameters], ...] = ()
    _take: Callable[..., None]

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._kind = name
        self._refused = Refusals(self.get_logger())
        self.ended = Future()
        """Done when the node is to end; it then returns from `run`."""
        self.joined = time.monotonic()
        """When the node began to discover others [s]."""
        descriptor = ParameterDescriptor(
            description='whether time is that of /clock, not of the system',
            type=ParameterType.PARAMETER_BOOL,
            read_only=True,
        )
        self.set_descriptor('use_sim_time', descriptor)

    def status_name(self, what: str) -> str:
        """Return the name of a status on /diagnostics, which nodes of all namespaces share."""
        return f'{self.get_namespace()}/{self._kind}: {what}'.lstrip('/')

    def load_kernels(self, warm_up: Callable[[], float]) -> None:
        """Make compiled kernels ready; it may take half a minute the first time."""
        self.get_logger().info('loading kernels, which are compiled the first time')
        self.get_logger().info(f'kernels loaded in {warm_up():.1f} s')

    def stop(self) -> None:
        """End what takes long early; called in a thread of its own before the node is destroyed.

        Does nothing by default.
        """

    # Parameters.

    def follow(
        self, declared: Sequence[tuple[str, Parameters]], take: Callable[..., None]
    ) -> None:
        """Call take(values, ...) whenever dynamic parameters have been set.

        `declared` pairs a prefix with what `declare` returned for it; take gets a new one of
        each, in the same order. Values that one of them does not allow are refused with the
        reason.
        """
        self._followed = tuple(declared)
        self._take = take

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all or none; the parameter services come here."""
        changes = {parameter.name: parameter.value for parameter in parameter_list}
        try:
            for name in changes:
                if not self.has_parameter(name):
                    raise ValueError(f'{self.get_name()} has no parameter {name}')
            dynamic = {
                name: value
                for name, value in changes.items()
                if not self.describe_parameter(name).read_only
            }
            new = tuple((prefix, _changed(old, dynamic, prefix)) for prefix, old in self._followed)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        result = super().set_parameters_atomically(parameter_list)
        if result.successful and dynamic:
            self._followed = new
            self.take_again()
        return result

    def take_again(self) -> None:
        """Hand over the values in force as if they had been set: what depends on them is made."""
        self._take(*(values for _, values in self._followed))

    # What goes out and comes in.

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, *args: Any, **options: Any
    ) -> Publisher:
        """Create a publisher as any node does, but keep the profile that is given.

        rclpy would change it by the qos_overrides of this topic, and so for the next ones.
        """
        return super().create_publisher(msg_type, topic, copy(qos_profile), *args, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **options: Any
    ) -> Subscription:
        """Subscribe as any node does, but keep impossible times from rclpy's clock.

        They would raise ValueError in the executor, and the node would end.
        """
        if msg_type is not Clock:
            return super().create_subscription(msg_type, topic, callback, *args, **options)

        def take(message: Clock) -> None:
            try:
                callback(message)
            except (ValueError, OverflowError) as error:
                self._refused.add(topic, Refused('no time', str(error)))

        return super().create_subscription(msg_type, topic, take, *args, **options)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any
    ) -> Service:
        """Create a service, rclpy's own included, whose bad requests get an empty response."""

        def respond(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except ValueError as error:
                self.get_logger().warning(f'{srv_name}: bad request: {error}')
                return response

        return super().create_service(srv_type, srv_name, respond, **options)


def _changed(values: Parameters, changes: dict[str, Any], prefix: str) -> Parameters:
    """Return the values with those changes that are theirs; ValueError if not allowed."""
    return values.with_values(
        {
            entry.name: check_parameter(entry.name, changes[entry.name], entry.field)
            for entry in values.walk(prefix)
            if entry.name in changes
        },
        prefix,
    )
