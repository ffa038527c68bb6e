# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes in domains of their own, and a node of the test's own among them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, ExitStack, suppress
import itertools
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from forked import Forked, NODES
from herding_ros.nodes.middleware import start_ros
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

LIMIT = 60.0
"""No condition is waited for any longer [s]."""

TIME_TO_END = 2.0
"""Time in which every node ends after a signal [s]."""

# Thirty domains for each of the three processes that may share the tests.
_WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw')) % 3
_FIRST = os.getpid() % 30
_domains = itertools.cycle([1 + 30 * _WORKER + (_FIRST + k) % 30 for k in range(30)])


@contextmanager
def _free_domain() -> Iterator[int]:
    """Take a ROS domain that no other test uses, of another run on this machine neither."""
    with socket.socket(socket.AF_UNIX) as taken:  # others cannot bind to the same name
        while True:
            number = next(_domains)
            with suppress(OSError):
                taken.bind(f'\0herding_ros, tests, domain {number}')
                break
        yield number


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return a ROS domain that no other test uses, on this machine alone."""
    with _free_domain() as number:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        yield number


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Show, with a test that failed, the last words of all processes that it started."""
    report = yield
    folder = getattr(item, 'funcargs', {}).get('tmp_path')
    if report.failed and folder is not None:
        for file in sorted(folder.rglob('*.log')):
            words = file.read_text(errors='replace').splitlines()[-30:]
            report.sections.append((f'{file.relative_to(folder)}', '\n'.join(words)))
    return report


class Process:
    """A program of ours as a process of its own, its output in a file."""

    def __init__(
        self,
        name: str,
        arguments: list[str],
        log: Path,
        domain: int,
        program: Path | None,
        afresh: bool,
    ) -> None:
        self._log = log
        log.touch()
        env = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
        self.process: Forked | subprocess.Popen[bytes]
        if program is None and name in NODES and not afresh:
            self.process = Forked(name, arguments, env, log)
            return
        module = ['-m', f'herding_ros.nodes.{name}'] if program is None else [str(program)]
        self.process = subprocess.Popen(
            [sys.executable, *module, *arguments],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=log.open('wb'),
            stderr=subprocess.STDOUT,
        )

    @property
    def log(self) -> str:
        return self._log.read_text(errors='replace')

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def ends_in_time(self, number: int, code: int = 0, times: int = 1) -> None:
        """Send a signal, once or in a row, and look how the process takes it."""
        begun = time.monotonic()
        for _ in range(times):
            self.process.send_signal(number)
            time.sleep(0.02)
        assert self.wait() == code, self.log
        took = time.monotonic() - begun
        print(f'ended after {took:.2f} s')
        assert took < TIME_TO_END, self.log
        assert 'Traceback' not in self.log

    def wait(self) -> int:
        return self.process.wait(LIMIT)

    def wait_for(self, text: str) -> None:
        end = time.monotonic() + LIMIT
        while text not in self.log:
            waits = self.process.poll() is None and time.monotonic() < end
            assert waits or text in self.log, f'waited for {text!r}, got:\n{self.log}'
            time.sleep(0.02)


def _wait_until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, 'waited too long'
        time.sleep(0.02)


@pytest.fixture
def wait_until() -> Callable[[Callable[[], object]], None]:
    """Return a function that waits for a condition, with a limit; for tests without a node."""
    return _wait_until


@contextmanager
def _starting(folder: Path, domain: int) -> Iterator[Callable[..., Process]]:
    """Give a function that starts programs; they are ended with the context.

    Nodes are forks of a process that has loaded them, unless they shall start `afresh`.
    """
    started: list[Process] = []

    def start_one(
        name: str,
        *arguments: str,
        program: Path | None = None,
        afresh: bool = False,
        **parameters: Any,
    ) -> Process:
        words = list(arguments)
        if parameters:
            words.append('--ros-args')
        for key, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            words += ['-p', f'{key.replace("__", ".")}:={text}']
        log = folder / f'{name}_{len(started)}.log'
        started.append(Process(name, words, log, domain, program, afresh))
        return started[-1]

    try:
        yield start_one
    finally:
        running = [each.process for each in started if each.process.poll() is None]
        for process in running:
            process.terminate()
        for process in running:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture
def start(tmp_path: Path, domain: int) -> Iterator[Callable[..., Process]]:
    """Return a function that starts a program, a node with its parameters; ended afterwards."""
    with _starting(tmp_path, domain) as start_one:
        yield start_one


@pytest.fixture(scope='module')
def start_for_all(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Peer]]:
    """Return a function that starts a node for all tests of a file, and returns its only peer."""
    with ExitStack() as stack:

        def start_one(name: str, **parameters: Any) -> Peer:
            domain = stack.enter_context(_free_domain())
            start = stack.enter_context(_starting(tmp_path_factory.mktemp(name), domain))
            start(name, **parameters)
            peer = Peer(domain)
            stack.callback(peer.close)
            return peer

        yield start_one


@pytest.fixture(scope='module')
def start_together(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[[], tuple[Callable[..., Process], Peer]]]:
    """Return a function that gives a start of nodes for all tests of a file, and their peer."""
    with ExitStack() as stack:

        def begin() -> tuple[Callable[..., Process], Peer]:
            domain = stack.enter_context(_free_domain())
            folder = tmp_path_factory.mktemp('together')
            peer = Peer(domain)
            stack.callback(peer.close)
            return stack.enter_context(_starting(folder, domain)), peer

        yield begin


class Peer:
    """A node of the test's own, to talk with the processes."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        # It, too, sends at once again what got lost, and shares no lock with others.
        start_ros(context=self._context, domain_id=domain)
        self.node = rclpy.create_node('peer', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[tuple[Any, str], Any] = {}

    def listen(self, kind: Any, topic: str, qos: Any = 1000) -> list[Any]:
        """Return the list that the messages of a topic are going to be in."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def add(self, node: Any) -> None:
        """Let another node be spun, too."""
        self._executor.add_node(node)

    def spin_until(self, condition: Callable[[], object], limit: float = LIMIT) -> None:
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, 'waited too long'
            self._executor.spin_once(timeout_sec=0.02)

    def spin_for(self, seconds: float) -> None:
        """Spin for a time in which something shall not happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)

    def talk_to(self, kind: Any, topic: str, listeners: int = 1, qos: Any = 1000) -> Any:
        """Return a publisher that is heard."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.spin_until(lambda: publisher.get_subscription_count() >= listeners)
        return publisher

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Return the answer of a service, which is asked once more when none comes.

        A server may be ready for requests before its answers reach the client.
        """
        if (kind, service) not in self._clients:  # all nodes hear of each new one
            self._clients[kind, service] = self.node.create_client(kind, service)
        client = self._clients[kind, service]
        self.spin_until(client.service_is_ready)
        for _ in range(3):
            future = client.call_async(request)
            with suppress(AssertionError):
                self.spin_until(future.done, LIMIT / 3)
                return future.result()
        raise AssertionError(f'{service} does not answer')

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def peer(domain: int) -> Iterator[Peer]:
    one = Peer(domain)
    yield one
    one.close()


@pytest.fixture
def environment(domain: int) -> dict[str, str]:
    return dict(os.environ)
