"""Asking another node for all its parameters, in the background."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, GetParameterTypes, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

ANSWER_TIMEOUT = 1.0
"""Time after which the node is asked once more [s]."""


class ParameterQuery:
    """A question to one node; `values` is None until it has answered.

    Nothing here waits: `advance()`, called from a timer, asks when the node is ready, and
    the answers come through the executor.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.values: dict[str, Any] | None = None
        self._node = node
        self._names = node.create_client(ListParameters, f'{name}/list_parameters')
        self._types = node.create_client(GetParameterTypes, f'{name}/get_parameter_types')
        self._values = node.create_client(GetParameters, f'{name}/get_parameters')
        self._next_try = 0.0

    def advance(self) -> None:
        """Ask if the node offers its services and no answer is on its way."""
        now = time.monotonic()
        clients = (self._names, self._types, self._values)
        if now >= self._next_try and all(client.service_is_ready() for client in clients):
            self._next_try = now + ANSWER_TIMEOUT
            _ask(self._names, ListParameters.Request(), self._take_names)

    def destroy(self) -> None:
        """Release the clients."""
        for client in (self._names, self._types, self._values):
            self._node.destroy_client(client)

    def _take_names(self, answer: ListParameters.Response) -> None:
        names = list(answer.result.names)

        def take_types(answer: GetParameterTypes.Response) -> None:
            # A node that is asked for a parameter without a value returns none at all.
            self._take_set_names(
                [
                    name
                    for name, kind in zip(names, answer.types, strict=False)
                    if kind != ParameterType.PARAMETER_NOT_SET
                ]
            )

        _ask(self._types, GetParameterTypes.Request(names=names), take_types)

    def _take_set_names(self, names: list[str]) -> None:
        def take_values(answer: GetParameters.Response) -> None:
            values = map(parameter_value_to_python, answer.values)
            self.values = dict(zip(names, values, strict=False))

        _ask(self._values, GetParameters.Request(names=names), take_values)


def _ask(client: Client, request: Any, take: Callable[[Any], None]) -> None:
    client.call_async(request).add_done_callback(lambda future: take(future.result()))
