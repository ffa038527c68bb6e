# SPDX-License-Identifier: Apache-2.0
"""How our nodes start and end."""

from __future__ import annotations

import atexit
from collections.abc import Callable
import os
from pathlib import Path
import sys
import tempfile
import traceback

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from .herding_node import HerdingNode
from .publishing import flush
from .signals import exit_at_once, ignore_signals, Signals

_TURN = 0.2
"""Time after which an idle node checks whether it has to end [s]."""


class CannotGoOnError(Exception):
    """Raised in a callback by a node that cannot go on, with the reason."""


def use_our_profiles() -> None:
    """Let Fast DDS read our settings (fastdds.xml, which says why), unless the user has some.

    Nodes with and without them talk with each other.
    """
    settings = str(Path(__file__).with_name('fastdds.xml'))
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', settings)


def find_log_folder() -> None:
    """Let ROS write its logs into a temporary folder where ~/.ros/log cannot be written.

    Otherwise rclpy would not start without a home, as in a container. ROS_LOG_DIR is respected.
    """
    if os.environ.get('ROS_LOG_DIR'):
        return
    home = os.environ.get('ROS_HOME') or os.path.join(os.environ.get('HOME', ''), '.ros')
    folder = Path(home).expanduser() / 'log'
    try:
        if not folder.is_absolute():
            raise FileNotFoundError
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):
        os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros_log-')
        print(
            f'the logs of ROS go to {os.environ["ROS_LOG_DIR"]}, since {folder} cannot be '
            'written; set ROS_LOG_DIR to choose',
            file=sys.stderr,
        )


def start_ros(args: list[str] | None = None) -> None:
    """Initialise rclpy; signals are left to the caller."""
    use_our_profiles()
    find_log_folder()
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def run(make_node: Callable[[], HerdingNode], args: list[str] | None = None) -> int:
    """Spin a node until SIGINT or SIGTERM, and let its last messages arrive.

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
    ended = Future()

    def end() -> None:
        node.stop()
        ended.set_result(None)

    signals.call(end)
    code = _spin(node, ended)
    flush(node)
    node.destroy_node()
    rclpy.shutdown()
    ignore_signals()
    return code


def _spin(node: HerdingNode, ended: Future) -> int:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not ended.done():  # spin_until_future_complete keeps something of every turn
            executor.spin_once(timeout_sec=_TURN)
    except CannotGoOnError as reason:
        node.get_logger().fatal(f'ending: {reason}')
        return 2
    except Exception:
        node.get_logger().fatal(f'ending: {traceback.format_exc()}')
        return 1
    return 0
