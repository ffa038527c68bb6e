# SPDX-License-Identifier: Apache-2.0
"""How our nodes start and end."""

from __future__ import annotations

import atexit
from collections.abc import Callable
import gc
import sys
import traceback

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy

from .herding_node import HerdingNode
from .middleware import start_ros
from .publishing import flush
from .signals import exit_at_once, ignore_signals, Signals

_TURN = 0.2
"""Time after which an idle node checks whether it has to end [s]."""


class CannotGoOnError(Exception):
    """Raised in a callback by a node that cannot go on, with the reason."""


def run(make_node: Callable[[], HerdingNode], args: list[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or its own end, and let its last messages arrive.

    Returns the exit code: 0; 2 when the node cannot start (ValueError) or go on
    (CannotGoOnError), with the reason printed; 1 after any other exception, with its traceback.
    """
    code = _run(make_node, args)
    # It takes Python a second to free the kernels, and nothing is left to be saved.
    atexit.register(exit_at_once, code)
    return code


def _run(make_node: Callable[[], HerdingNode], args: list[str] | None) -> int:
    signals = Signals()
    try:
        start_ros(args)
        node = make_node()
    except (ValueError, ParameterException, _rclpy.RCLError) as error:
        print(f'cannot start: {error}', file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    gc.freeze()  # a search for garbage in all that has been loaded would take a control period

    def end() -> None:
        node.stop()
        node.ended.set_result(None)

    signals.call(end)
    code = _spin(node)
    flush(node)
    node.destroy_node()
    rclpy.shutdown()
    ignore_signals()
    return code


def _spin(node: HerdingNode) -> int:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not node.ended.done():  # spin_until_future_complete keeps something of every turn
            executor.spin_once(timeout_sec=_TURN)
    except CannotGoOnError as reason:
        node.get_logger().fatal(f'ending: {reason}')
        return 2
    except Exception:
        node.get_logger().fatal(f'ending: {traceback.format_exc()}')
        return 1
    return 0
