"""The whole system at once: sim, controller and recorder, a bag, a picture and a summary."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import nullcontext
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console
from rich.live import Live
from rich.text import Text

from herding_ros.model.scenario import GOAL

from .running import start_ros

_ARRIVED, _TIMED_OUT, _BAD_ARGUMENTS, _CHILD_DIED, _INTERRUPTED = 0, 1, 2, 3, 130
_QUESTIONS = 30.0
"""Time after a run that the recorder gets at most to ask sim and controller for parameters [s]."""

_PATIENCE = 20.0
"""Time that a child gets to end by itself [s]."""


def _number(
    kind: type[int] | type[float], low: float | None = None, above: float | None = None
) -> Callable[[str], float]:
    """Return a reader of finite numbers of at least `low`, or `above` a bound, for argparse."""
    words = f'{"an integer" if kind is int else "a finite number"}'
    words += f' of at least {low}' if low is not None else ''
    words += f' above {above}' if above is not None else ''

    def read(text: str) -> float:
        refusal = argparse.ArgumentTypeError(f'{text} is given, allowed is {words}')
        try:
            value = kind(text)
        except ValueError:
            raise refusal from None
        too_low = (low is not None and value < low) or (above is not None and value <= above)
        if too_low or not math.isfinite(value):
            raise refusal
        return value

    return read


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='herd',
        description='Herd a flock: starts sim, controller and recorder as ROS 2 processes and '
        'ends when the flock is home and together. Writes bag/ (rosbag2, mcap), '
        'trajectories.png, summary.json and the logs of the nodes. All traffic stays on this '
        'machine, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set.',
        epilog='Exit code: 0 the flock arrived, 1 time ran out, 2 bad arguments, 3 a process '
        'died, 130 interrupted by Ctrl-C. Example: herd --dogs 3 --goal 1 1 --seed 4',
    )
    add = parser.add_argument
    add('--sheep', type=_number(int, low=1), default=30, metavar='N', help='number of sheep (30)')
    add('--dogs', type=_number(int, low=1), default=5, metavar='M', help='number of dogs (5)')
    add('--sigma', type=_number(float, low=0), default=0.01, help='noise of the sheep (0.01)')
    add(
        '--goal', type=_number(float), nargs=2, default=GOAL, metavar=('X', 'Y'),
        help='destination in metres (0.5 0.5); the flock starts around the origin',
    )  # fmt: skip
    add('--seed', type=_number(int, low=0), default=0, help='same seed, same run (0)')
    add(
        '--time-limit', type=_number(float, above=0), default=400.0, metavar='S',
        help='simulated seconds to try (400)',
    )  # fmt: skip
    add(
        '--real-time', type=_number(float, above=0), metavar='FACTOR',
        help='run at FACTOR x real time instead of in lockstep, as fast as possible',
    )  # fmt: skip
    add(
        '--out', type=Path, metavar='DIR',
        help='where to write (runs/<time>); must not hold a bag yet',
    )  # fmt: skip
    return parser


class Child:
    """One node process; what it says goes into a log file."""

    def __init__(self, name: str, parameters: dict[str, object], logs: Path) -> None:
        """Start the node with the given parameters."""
        self.name = name
        self.log = logs / f'{name}.log'
        arguments = ['--ros-args']
        for key, value in parameters.items():
            arguments += ['-p', f'{key}:={_yaml(value)}']
        # A session of its own: Ctrl-C reaches the children through us, in the right order.
        self.process = subprocess.Popen(
            [sys.executable, '-m', f'herding_ros.nodes.{name}', *arguments],
            stdin=subprocess.DEVNULL,
            stdout=self.log.open('wb'),
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def end(self) -> None:
        """Ask the node to end, and insist if it does not."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def last_words(self) -> str:
        """Return the last lines of its log."""
        return '\n'.join(self.log.read_text(errors='replace').splitlines()[-12:])


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(_yaml(float(each)) for each in value) + ']'
    return repr(value) if isinstance(value, float) else str(value)


class Watcher(Node):
    """Follows /diagnostics."""

    def __init__(self) -> None:
        """Subscribe."""
        super().__init__('herd')
        self.sim: dict[str, str] = {}
        self.plan: dict[str, str] = {}
        self.recorder: dict[str, str] = {}
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name == 'sim: herd':
                self.sim = values
            elif status.name == 'controller: plan':
                self.plan = values
            elif status.name == 'recorder: bag':
                self.recorder = values

    @property
    def parameters_known(self) -> bool:
        """Whether the recorder has asked sim and controller for their parameters."""
        known = self.recorder.get('parameters_of', '').split()
        return {'/sim', '/controller'} <= set(known)

    @property
    def finished(self) -> bool:
        """Whether the sim stands still for good."""
        return self.sim.get('finished') == 'True'

    @property
    def arrived(self) -> bool:
        """Whether it does so because the flock is home."""
        return self.sim.get('arrived') == 'True'

    @property
    def time(self) -> float:
        """Simulated time of the newest status [s]."""
        return float(self.sim['time_s'])

    def line(self, since: float, wall: float) -> str:
        """Say how the herding goes, in one line; `wall` seconds ago the time was `since`."""
        if not self.sim:
            return 'starting the nodes ...'
        pace = f'{(self.time - since) / wall:4.1f}' if self.time > since else '   -'
        distance, spread = (float(self.sim[k]) for k in ('distance_m', 'spread_m'))
        solve = f'{float(self.plan["solve_ms"]):.0f} ms' if self.plan else '-'
        return (
            f't {self.time:5.1f} s  to go {distance:5.3f} m  spread {spread:5.3f} m  '
            f'solve {solve:>6}  {pace} x real time'
        )


def lead_at(real_time: float) -> float:
    """Return the controller's lead [s] at a multiple of real time.

    A solve takes wall time: the faster the sim's clock, the earlier it has to begin.
    """
    return min(max(2.0, 0.5 * real_time), 9.0)


def _start_children(options: argparse.Namespace, logs: Path) -> list[Child]:
    lockstep = options.real_time is None
    shared = {'goal': options.goal, 'lockstep': lockstep, 'wait_for': 'recorder',
              'dogs': options.dogs, 'seed': options.seed,
              'crowd.noise': options.sigma}  # fmt: skip
    recorder = {'bag': options.out / 'bag', 'use_sim_time': True}
    # In lockstep the stamps say the time, and the clock would only wake the controller.
    controller = {**shared, 'use_sim_time': not lockstep}
    sim = {**shared, 'sheep': options.sheep, 'stop_on_arrival': True,
           'time_limit': options.time_limit}  # fmt: skip
    if not lockstep:
        sim['real_time_factor'] = options.real_time
        controller['lead'] = lead_at(options.real_time)
    return [
        Child('recorder', recorder, logs),
        Child('controller', controller, logs),
        Child('sim', sim, logs),
    ]


def _watch(
    children: list[Child], watcher: Watcher, interrupted: threading.Event, console: Console
) -> int:
    """Show how it goes until it is over; return the exit code."""
    executor = SingleThreadedExecutor()
    executor.add_node(watcher)
    begun = shown = finished = time.monotonic()
    t0 = 0.0
    # One live line for people; a line every few seconds for files and pipes.
    with (
        Live(console=console, auto_refresh=False) if console.is_terminal else nullcontext() as live
    ):
        while True:
            executor.spin_once(timeout_sec=0.1)
            now = time.monotonic()
            if not watcher.sim:
                begun = now
            elif not t0:
                t0 = max(watcher.time, 1e-9)
            dead = [child for child in children if child.process.poll() is not None]
            if not watcher.finished:
                finished = now
            told = watcher.parameters_known or now > finished + _QUESTIONS
            over = (watcher.finished and told) or dead or interrupted.is_set()
            if over or now - shown > (0.2 if live else 5.0):
                shown = now
                line = Text(watcher.line(t0, now - begun), no_wrap=True)
                if live:
                    live.update(line, refresh=True)
                else:
                    console.print(line, soft_wrap=True)
            if over:
                break
    for child in dead:
        console.print(f'{child.name} died (exit code {child.process.returncode}):', style='red')
        console.print(child.last_words(), markup=False, soft_wrap=True)
        return _CHILD_DIED
    if watcher.finished and not watcher.parameters_known:
        console.print('the bag lacks the parameters of the nodes', style='red')
    if not watcher.finished:
        console.print('interrupted: closing the bag')
        return _INTERRUPTED
    return _ARRIVED if watcher.arrived else _TIMED_OUT


def main(args: list[str] | None = None) -> int:
    """Run the program; see --help for the exit codes."""
    options = _parser().parse_args(args)
    console = Console(highlight=False)
    options.out = (options.out or Path('runs') / time.strftime('%Y-%m-%d_%H-%M-%S')).absolute()
    if (options.out / 'bag').exists():
        console.print(f'{options.out}/bag exists already; give another --out', style='red')
        return _BAD_ARGUMENTS
    logs = options.out / 'log'
    try:
        logs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        console.print(f'cannot write into {options.out}: {error}', style='red')
        return _BAD_ARGUMENTS

    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    console.print(
        f'herding {options.sheep} sheep with {options.dogs} dogs to '
        f'({options.goal[0]:g}, {options.goal[1]:g}) on ROS_DOMAIN_ID '
        f'{os.environ.get("ROS_DOMAIN_ID", "0")}; output in {options.out}',
        soft_wrap=True,
    )
    # Nothing is raised in the middle of something: a signal is only noted.
    interrupted = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    start_ros([])
    watcher = Watcher()
    children: list[Child] = []
    try:
        children = _start_children(options, logs)
        code = _watch(children, watcher, interrupted, console)
    finally:
        for child in reversed(children):  # the recorder last, so that it hears everything
            child.end()
        watcher.destroy_node()
        rclpy.shutdown()
    recorder = children[0]
    if recorder.process.returncode == 1:  # it has told the full disk, and gone on
        console.print('the bag is not complete:', style='red')
        console.print(recorder.last_words(), markup=False, soft_wrap=True)
    if (options.out / 'bag').exists():
        from herding_ros.report.cli import write_report  # it takes a second to load: not before

        try:
            write_report(options.out / 'bag', options.out, console)
        except (OSError, ValueError) as error:
            console.print(f'no report: {error}', style='red', soft_wrap=True)
    return code


if __name__ == '__main__':
    sys.exit(main())
