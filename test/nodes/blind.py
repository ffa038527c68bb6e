# SPDX-License-Identifier: Apache-2.0
"""A node that does not see its duplicates until it is active itself, and waits less for them.

As if both had begun at the same instant. Run as a program with the name of the node before the
ROS arguments.
"""

from importlib import import_module
import sys
from typing import Any

from herding_ros.nodes import duplicates
from herding_ros.nodes.herding_node import HerdingNode

CLAIM = 1.5
"""Instead of that of `duplicates` [s]."""

find = HerdingNode.get_publishers_info_by_topic
unseen: set[tuple[int, ...]] = set()
found: set[str] = set()


def blind_wait(node: HerdingNode, topic: str, _: str) -> None:
    unseen.update(tuple(info.endpoint_gid) for info in find(node, topic))


def blind_find(node: HerdingNode, topic: str, *args: Any) -> list[Any]:
    """Hide others until the node has found its own publisher of the topic."""
    infos = find(node, topic, *args)
    if unseen and topic not in found:
        found.add(topic)
        return [info for info in infos if tuple(info.endpoint_gid) not in unseen]
    return infos


if __name__ == '__main__':
    duplicates._wait_until_nobody_publishes = blind_wait
    duplicates.CLAIM = CLAIM
    HerdingNode.get_publishers_info_by_topic = blind_find  # type: ignore[method-assign]
    sys.exit(import_module(f'herding_ros.nodes.{sys.argv[1]}').main(sys.argv[2:]))
