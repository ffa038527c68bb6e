# SPDX-License-Identifier: Apache-2.0
"""A request for all parameters of another node, in the background."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, GetParameterTypes, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

REPLY_TIMEOUT = 1.0
"""Time after which the request is repeated [s]."""


class ParameterQuery:
    """A request to one node; `values` is None until the reply has come.

    Nothing here waits: `advance()`, called from a timer, sends the request when the node is
    ready, and the replies come through the executor.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.values: dict[str, Any] | None = None
        self._node = node
        self._names = node.create_client(ListParameters, f'{name}/list_parameters')
        self._types = node.create_client(GetParameterTypes, f'{name}/get_parameter_types')
        self._values = node.create_client(GetParameters, f'{name}/get_parameters')
        self._next_try = 0.0
        self._asked: Future | None = None

    def advance(self) -> None:
        """Send the request if the node offers its services and no reply is on its way."""
        now = time.monotonic()
        clients = (self._names, self._types, self._values)
        if now >= self._next_try and all(client.service_is_ready() for client in clients):
            self._next_try = now + REPLY_TIMEOUT
            if self._asked is not None:  # a node that is there, but does not spin
                self._names.remove_pending_request(self._asked)
            self._asked = _call(self._names, ListParameters.Request(), self._take_names)

    def destroy(self) -> None:
        """Release the clients."""
        for client in (self._names, self._types, self._values):
            self._node.destroy_client(client)

    def _take_names(self, reply: ListParameters.Response) -> None:
        names = list(reply.result.names)

        def take_types(reply: GetParameterTypes.Response) -> None:
            # A node that is asked for a parameter without a value returns none at all.
            self._take_set_names(
                [
                    name
                    for name, kind in zip(names, reply.types, strict=False)
                    if kind != ParameterType.PARAMETER_NOT_SET
                ]
            )

        _call(self._types, GetParameterTypes.Request(names=names), take_types)

    def _take_set_names(self, names: list[str]) -> None:
        def take_values(reply: GetParameters.Response) -> None:
            values = map(parameter_value_to_python, reply.values)
            self.values = dict(zip(names, values, strict=False))

        _call(self._values, GetParameters.Request(names=names), take_values)


def _call(client: Client, request: Any, take: Callable[[Any], None]) -> Future:
    future = client.call_async(request)
    future.add_done_callback(lambda future: take(future.result()))
    return future
