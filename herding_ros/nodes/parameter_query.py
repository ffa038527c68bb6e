# SPDX-License-Identifier: Apache-2.0
"""Requests for all parameters of other nodes, in the background."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
import time
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, GetParameterTypes, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.task import Future

from .publishing import full_name, node_of

REPLY_TIMEOUT = 1.0
"""Time after which the request is repeated [s]."""

LOOK_PERIOD = 1.0
"""Time after which nodes are looked at though their names are the same: one may be another [s]."""

_KINDS = {kind.value for kind in Parameter.Type}


class ParameterQueries:
    """Asks the nodes whose full names `is_wanted` accepts, each once in its life."""

    def __init__(self, node: Node, is_wanted: Callable[[str], bool]) -> None:
        self._node = node
        self._is_wanted = is_wanted
        self._names: list[tuple[str, str]] = []
        self._next_look = 0.0
        self._lives: dict[str, set[bytes]] = {}
        self._queries: dict[str, ParameterQuery] = {}

    @property
    def names(self) -> Collection[str]:
        """Full names of the nodes that are there and wanted."""
        return self._lives.keys()

    def answers(self) -> dict[str, dict[str, Any]]:
        """Ask, and return the values of nodes that have answered since the last call."""
        names, now = self._node.get_node_names_and_namespaces(), time.monotonic()
        if names != self._names or now >= self._next_look:
            self._names, self._next_look = names, now + LOOK_PERIOD
            self._look({full_name(namespace, name) for name, namespace in names})
        answers = {}
        for name, query in list(self._queries.items()):
            query.advance()
            if query.values is not None:
                answers[name] = query.values
                self._end(name)
        return answers

    def _look(self, names: Iterable[str]) -> None:
        """Find out who is new.

        A name need not go when another node takes it: one that was killed stays in the graph for
        a while. But each node has a publisher of its own of its parameters' changes.
        """
        publishers = defaultdict(set)
        for each in self._node.get_publishers_info_by_topic('/parameter_events'):
            publishers[node_of(each)].add(bytes(each.endpoint_gid))
        before, self._lives = self._lives, {}
        for name in filter(self._is_wanted, names):
            known = before.get(name, set())
            self._lives[name] = publishers[name] or known
            is_another = known and self._lives[name] - known
            if (name not in before or is_another) and name not in self._queries:
                self._queries[name] = ParameterQuery(self._node, name)
        for name in self._queries.keys() - self._lives.keys():
            self._end(name)

    def _end(self, name: str) -> None:
        self._queries.pop(name).destroy()


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
            self.values = {
                name: parameter_value_to_python(value)
                for name, value in zip(names, reply.values, strict=False)
                if value.type in _KINDS
            }

        _call(self._values, GetParameters.Request(names=names), take_values)


def _call(client: Client, request: Any, take: Callable[[Any], None]) -> Future:
    future = client.call_async(request)
    future.add_done_callback(lambda future: take(future.result()))
    return future
