# SPDX-License-Identifier: Apache-2.0
"""What other nodes answer when they are asked for their parameters."""

from __future__ import annotations

from typing import Any

from herding_ros.nodes.parameter_query import ParameterQueries
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, GetParameterTypes, ListParameters
import rclpy


def test_value_of_a_kind_that_nobody_knows_is_left_out(peer: Any) -> None:
    """What is raised when an answer comes is raised by the executor, and ends the recorder."""
    odd = rclpy.create_node('odd', context=peer.node.context, start_parameter_services=False)
    peer.add(odd)

    def serve(kind: Any, name: str, **values: Any) -> None:
        answer = kind.Response(**values)
        odd.create_service(kind, f'odd/{name}', lambda *_: answer)

    number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.5)
    names = ListParameters.Response().result
    names.names = ['usual', 'odd']
    serve(ListParameters, 'list_parameters', result=names)
    serve(GetParameterTypes, 'get_parameter_types', types=[number.type, 200])
    serve(GetParameters, 'get_parameters', values=[number, ParameterValue(type=200)])
    queries = ParameterQueries(peer.node, '/odd'.__eq__)
    found: dict[str, dict[str, Any]] = {}

    def is_answered() -> bool:
        found.update(queries.answers())
        return bool(found)

    peer.spin_until(is_answered)
    assert found == {'/odd': {'usual': 1.5}}
