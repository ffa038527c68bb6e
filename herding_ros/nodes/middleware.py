# SPDX-License-Identifier: Apache-2.0
"""The settings of the middleware: how nodes reach each other, and who can reach them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import sys
import tempfile
from typing import Any

from herding_ros.model.kernel_cache import is_writable
import rclpy
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions

_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_LOCALHOST_ONLY = 'ROS_LOCALHOST_ONLY'  # deprecated; it overrides the range
_PEERS = 'ROS_STATIC_PEERS'
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_ALL_INTERFACES = Path(__file__).resolve().with_name('fastdds.xml')
_LOOPBACK = Path(__file__).resolve().with_name('fastdds_localhost.xml')


def start_ros(args: list[str] | None = None, **options: Any) -> None:
    """Initialise rclpy with our settings of Fast DDS; signals are left to the caller.

    If `ROS_AUTOMATIC_DISCOVERY_RANGE` is `LOCALHOST`, only this machine can reach the nodes. A
    user's own settings of Fast DDS replace ours. Nodes with and without ours talk with each other.

    Parameters
    ----------
    args
        Command line; default: that of the process.
    options
        Other arguments of `rclpy.init`.

    """
    find_log_folder()
    with _our_settings():
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO, **options)


def find_log_folder() -> None:
    """Let ROS write its logs into a temporary folder where ~/.ros/log cannot be written.

    Otherwise rclpy would not start without a home, as in a container. ROS_LOG_DIR is respected.
    """
    if os.environ.get('ROS_LOG_DIR'):
        return
    home = os.environ.get('ROS_HOME') or os.path.join(os.environ.get('HOME', ''), '.ros')
    folder = Path(os.path.expanduser(home), 'log')  # ~ is left as it is for who has no home
    if not (folder.is_absolute() and is_writable(folder)):
        os.environ['ROS_LOG_DIR'] = tempfile.mkdtemp(prefix='ros_log-')
        print(
            f'the logs of ROS go to {os.environ["ROS_LOG_DIR"]}, since {folder} cannot be '
            'written; set ROS_LOG_DIR to choose',
            file=sys.stderr,
        )


@contextmanager
def _our_settings() -> Iterator[None]:
    """Let Fast DDS read our settings; rclpy.init, within this context, does not alter them."""
    local = os.environ.get(_LOCALHOST_ONLY) == '1' or os.environ.get(_RANGE) == 'LOCALHOST'
    users = _users_settings()
    if users is None:
        os.environ[_PROFILES] = str(_LOOPBACK if local else _ALL_INTERFACES)
    changes: dict[str, str | None] = {}
    if local and rclpy.get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
        if users is not None:
            _warn(
                f'the Fast DDS settings in {users} replace ours: another machine that names this '
                f'one in its {_PEERS} can reach this node in spite of {_RANGE}=LOCALHOST'
            )
        else:
            if os.environ.get(_PEERS):
                _warn(f'{_PEERS} is ignored with {_RANGE}=LOCALHOST; with SUBNET it works')
            # With LOCALHOST it would add a transport that is open to all networks.
            changes = {_RANGE: 'SYSTEM_DEFAULT', _LOCALHOST_ONLY: None}
    with _environment(changes):
        yield


def _warn(text: str) -> None:
    get_logger('herding_ros').warning(text)


@contextmanager
def _environment(changes: dict[str, str | None]) -> Iterator[None]:
    """Set environment variables, or remove those that shall be None, for a while."""
    before = {name: os.environ.get(name) for name in changes}
    _set_environment(changes)
    try:
        yield
    finally:
        _set_environment(before)


def _set_environment(values: dict[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _users_settings() -> Path | None:
    """Return the file that Fast DDS would read instead of ours, or after it."""
    named = os.environ.get(_PROFILES)
    if named and Path(named).resolve() not in (_ALL_INTERFACES, _LOOPBACK):
        return Path(named)
    found = Path('DEFAULT_FASTRTPS_PROFILES.xml').absolute()
    skipped = os.environ.get('SKIP_DEFAULT_XML_FILE', '').startswith('1')
    return found if found.exists() and not skipped else None
