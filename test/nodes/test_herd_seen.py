# SPDX-License-Identifier: Apache-2.0
"""Which of the herd's topics a page follows, as they come and go."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from herding_ros.nodes import herd_seen, messages
from herding_ros.nodes.herd_seen import HerdSeen
from herding_ros.nodes.refusals import Refusals
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2


def test_truth_that_nobody_publishes_is_not_waited_for(peer: Any) -> None:
    """Others may listen to it, and the page itself has, as long as there was a sim."""
    node, x = peer.node, np.array([[1.0, 2.0], [3.0, 4.0]])
    seen = HerdSeen(node, 'map', Refusals(node.get_logger()))
    peer.listen(PointCloud2, 'truth/sheep')
    sheep = node.create_publisher(PointCloud2, 'sheep', 1)
    truth = node.create_publisher(PointCloud2, 'truth/sheep', 1)
    dog = node.create_publisher(Odometry, 'truth/dog_1/odom', 1)

    def shows(publisher: Any, factor: float) -> None:
        def is_shown() -> bool:
            seen.look_around()
            publisher.publish(messages.cloud(factor * x, 0.0 * x, 1_000_000_000, 'map'))
            seen.take()
            return seen.frame is not None and np.allclose(seen.frame.x, factor * x)

        peer.spin_until(is_shown)

    shows(truth, 1.0)
    peer.spin_until(lambda: dog.get_subscription_count())
    dog.publish(messages.odometry(x[0], 0.0 * x[0], 0, 1_000_000_000, 'map'))

    def has_dog() -> bool:
        seen.take()
        return seen.frame is not None and seen.frame.numbers == (1,)

    peer.spin_until(has_dog)
    node.destroy_publisher(truth)
    node.destroy_publisher(dog)
    shows(sheep, 2.0)
    assert seen.frame is not None
    assert seen.frame.numbers == ()


def test_dogs_that_are_silent_while_sheep_come_are_gone(
    peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As those of a former run, which need not have gone on for longer than the present one."""
    node, x = peer.node, np.array([[1.0, 2.0], [3.0, 4.0]])
    seen = HerdSeen(node, 'map', Refusals(node.get_logger()))
    sheep = node.create_publisher(PointCloud2, 'sheep', 1)
    dogs = [node.create_publisher(Odometry, f'dog_{m}/odom', 1) for m in (1, 2)]

    def look() -> bool:
        seen.look_around()
        return all(each.get_subscription_count() for each in (sheep, *dogs))

    peer.spin_until(look)

    def numbers(second: int, *there: int) -> tuple[int, ...]:
        """Return who is seen a second after these dogs, and the sheep, were."""
        monkeypatch.setattr(herd_seen, 'time', SimpleNamespace(monotonic=lambda: float(second)))
        for m in there:
            dogs[m - 1].publish(messages.odometry(x[0], 0.0 * x[0], m, second * 10**9, 'map'))
        sheep.publish(messages.cloud(x, 0.0 * x, second * 10**9, 'map'))
        peer.spin_until(lambda: seen.take() and seen.ns == second * 10**9)
        peer.spin_for(0.05)
        seen.take()
        assert seen.frame is not None
        return seen.frame.numbers

    assert numbers(1, 1, 2) == (1, 2)
    assert numbers(101) == (1, 2)  # all stood still, sheep come first
    assert numbers(102, 1) == (1, 2)
    assert [numbers(second, 1) for second in range(103, 112)][-1] == (1,)
    assert numbers(112, 1, 2) == (1, 2)
