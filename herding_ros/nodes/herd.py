# SPDX-License-Identifier: Apache-2.0
"""The whole system at once: sim, controller and recorder, a bag, a picture and a summary."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
import itertools
import os
from pathlib import Path
import sys
import time

from herding_ros.control.lead import FASTEST, lead_at, SLOWEST
from herding_ros.model.flock import MOST_STRAYS
from herding_ros.model.parameters import LARGE, TINY
from herding_ros.model.scenario import GOAL, MOST_DOGS, MOST_SHEEP
from herding_ros.programs import INTERRUPTED
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console

from .middleware import start_ros
from .progress import ProgressLine, Watcher
from .signals import note_signals, Noted
from .supervision import Child

_ARRIVED, _TIMED_OUT, _BAD_ARGUMENTS, _CHILD_DIED = 0, 1, 2, 3

_FOR_PARAMETERS = 30.0
"""Longest time after a run in which the recorder may receive the nodes' parameters [s]."""


def _number(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Return a reader of numbers from `low` to `high` for argparse."""

    def read(text: str) -> float:
        words = 'an integer' if kind is int else 'a number'
        refusal = argparse.ArgumentTypeError(
            f'must be {words} from {low:g} to {high:g}, got {text}'
        )
        try:
            value = kind(text)
        except ValueError:
            raise refusal from None
        if not low <= value <= high:
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
        epilog='Exit code: 0 the flock arrived, 1 it did not, 2 bad arguments, 3 a process '
        'died, 130 interrupted by Ctrl-C. Example: herd --dogs 3 --goal 1 1 --seed 4',
    )
    add = parser.add_argument
    add(
        '--sheep',
        type=_number(int, 1, MOST_SHEEP),
        default=30,
        metavar='N',
        help='number of sheep (30)',
    )
    add(
        '--dogs',
        type=_number(int, 1, MOST_DOGS),
        default=5,
        metavar='M',
        help='number of dogs (5)',
    )
    add('--sigma', type=_number(float, 0.0, LARGE), default=0.01, help='noise of the sheep (0.01)')
    add(
        '--goal', type=_number(float, -LARGE, LARGE), nargs=2, default=GOAL, metavar=('X', 'Y'),
        help='destination in metres (0.5 0.5); the flock starts around the origin',
    )  # fmt: skip
    add('--seed', type=_number(int, 0, 2**63 - 1), default=0, help='same seed, same run (0)')
    add(
        '--strays', type=_number(int, 0, MOST_STRAYS), default=0, metavar='K',
        help='number of sheep that may be left behind (0)',
    )  # fmt: skip
    add(
        '--time-limit', type=_number(float, TINY, LARGE), default=400.0, metavar='S',
        help='simulated seconds to try (400)',
    )  # fmt: skip
    add(
        '--real-time', type=_number(float, SLOWEST, FASTEST), metavar='FACTOR',
        help='run at FACTOR x real time instead of in lockstep, as fast as possible',
    )  # fmt: skip
    add(
        '--out', type=Path, metavar='DIR',
        help='where to write (runs/<time>); must not hold a bag yet',
    )  # fmt: skip
    return parser


def _new_folder() -> Path:
    """Make runs/<time>; two runs that begin in the same second have one each."""
    runs = Path('runs').absolute()
    runs.mkdir(exist_ok=True)
    begun = time.strftime('%Y-%m-%d_%H-%M-%S')
    for ending in itertools.chain([''], map('_{}'.format, itertools.count(2))):
        with suppress(FileExistsError):
            (runs / f'{begun}{ending}').mkdir()
            break
    return runs / f'{begun}{ending}'


def _check_folder(folder: Path) -> None:
    """Raise ValueError if a run cannot be written into a folder."""
    if (folder / 'bag').exists():
        raise ValueError(f'{folder}/bag exists already; give another --out')
    try:
        str(folder).encode()
    except UnicodeEncodeError:  # parameters of ROS nodes are UTF-8
        raise ValueError(f'--out must be UTF-8, got {os.fsencode(folder)!r}') from None


def _start_children(options: argparse.Namespace, logs: Path) -> list[Child]:
    lockstep = options.real_time is None
    shared = {'goal': options.goal, 'lockstep': lockstep, 'wait_for': 'recorder',
              'dogs': options.dogs, 'seed': options.seed,
              'crowd.noise': options.sigma}  # fmt: skip
    recorder = {'bag': options.out / 'bag', 'use_sim_time': True}
    # In lockstep the stamps are the time, and the clock would only wake the controller.
    controller = {**shared, 'use_sim_time': not lockstep}
    sim = {**shared, 'sheep': options.sheep, 'stop_on_arrival': True,
           'arrival.strays': options.strays, 'time_limit': options.time_limit}  # fmt: skip
    if not lockstep:
        sim['real_time_factor'] = options.real_time
        controller['lead'] = lead_at(options.real_time)
    return [
        Child('recorder', recorder, logs),
        Child('controller', controller, logs),
        Child('sim', sim, logs),
    ]


def _watch(children: list[Child], watcher: Watcher, interrupted: Noted, console: Console) -> int:
    """Show how it goes until it is over; return the exit code."""
    executor = SingleThreadedExecutor()
    executor.add_node(watcher)
    line = ProgressLine(watcher, console)
    finished = time.monotonic()
    with line.shown():
        over = False
        while not over:
            executor.spin_once(timeout_sec=0.1)
            now = time.monotonic()
            if not watcher.finished:
                finished = now
            recorded = watcher.parameters_recorded or now > finished + _FOR_PARAMETERS
            dead = [child for child in children if child.died]
            over = (watcher.finished and recorded) or bool(dead) or interrupted.is_set()
            line.update(now, at_once=over)
    for child in dead:
        console.print(f'{child.name} died (exit code {child.process.returncode}):', style='red')
        console.print(child.last_lines(), markup=False, soft_wrap=True)
        return _CHILD_DIED
    if not watcher.finished:
        console.print('interrupted: closing the bag')
        return INTERRUPTED
    if not watcher.parameters_recorded:
        console.print('the bag lacks the parameters of the nodes', style='red')
    if not watcher.arrived:
        console.print(watcher.outcome, markup=False, soft_wrap=True)
    return _ARRIVED if watcher.arrived else _TIMED_OUT


def _run(options: argparse.Namespace, logs: Path, console: Console) -> int:
    """Run the nodes until it is over; return the exit code."""
    interrupted = note_signals()
    start_ros([])
    watcher = Watcher()
    children: list[Child] = []
    try:
        children = _start_children(options, logs)
        code = _watch(children, watcher, interrupted, console)
    finally:
        for child in reversed(children):  # the recorder last, so that it receives everything
            child.end()
        watcher.destroy_node()
        rclpy.shutdown()
    recorder = children[0]
    if recorder.process.returncode == 1:  # it has logged the full disk, and gone on
        console.print('the bag is not complete:', style='red')
        console.print(recorder.last_lines(), markup=False, soft_wrap=True)
    return code


def main(args: list[str] | None = None) -> int:
    """Run the program; see --help for the exit codes."""
    parser = _parser()
    options = parser.parse_args(args)
    if options.strays >= options.sheep:
        parser.error(
            f'argument --strays: must be less than --sheep, {options.sheep}, got {options.strays}'
        )
    console = Console(highlight=False)
    try:
        options.out = options.out.absolute() if options.out else _new_folder()
        _check_folder(options.out)
        logs = options.out / 'log'
        logs.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        console.print(f'cannot write the run: {error}', style='red', markup=False, soft_wrap=True)
        return _BAD_ARGUMENTS

    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    console.print(
        f'herding {options.sheep} sheep with {options.dogs} dogs to '
        f'({options.goal[0]:g}, {options.goal[1]:g}) on ROS_DOMAIN_ID '
        f'{os.environ.get("ROS_DOMAIN_ID", "0")}; output in {options.out}',
        soft_wrap=True,
    )
    code = _run(options, logs, console)
    if (options.out / 'bag').exists():
        from herding_ros.report.cli import write_report  # it takes a second to load: not before

        try:
            write_report(options.out / 'bag', options.out, console)
        except (OSError, ValueError) as error:
            console.print(f'no report: {error}', style='red', soft_wrap=True)
    return code


if __name__ == '__main__':
    sys.exit(main())
