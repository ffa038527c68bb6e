# SPDX-License-Identifier: Apache-2.0
"""The whole system at once: sim, controller and recorder, a bag, a picture and a summary."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
import itertools
import os
from pathlib import Path
import shlex
import sys
import time
from typing import Any

from herding_ros.control.lead import FASTEST, lead_at, SLOWEST
from herding_ros.model.field import read_field, shipped_fields
from herding_ros.model.flock import MOST_STRAYS
from herding_ros.model.kernel_cache import has_kernels
from herding_ros.model.parameters import LARGE, TINY
from herding_ros.model.scenario import GOAL, MOST_DOGS, MOST_SHEEP
from herding_ros.programs import INTERRUPTED
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console

from .configuration import assignment, awaited, checked, parameters_of
from .middleware import start_ros
from .progress import ProgressLine, Watcher
from .signals import note_signals, Noted
from .supervision import Child

_ARRIVED, _TIMED_OUT, _BAD_ARGUMENTS, _CHILD_DIED = 0, 1, 2, 3

_VIEWED, _FASTEST_VIEWED = 2.0, 10.0
"""Multiples of real time with --view: at first, and what the controller is prepared for."""

_FOR_PARAMETERS = 30.0
"""Longest time after a run in which the recorder may receive the nodes' parameters [s]."""


_NEXT = (
    ('look at', 'trajectories.png'),
    ('open in a browser:', 'replay.html'),
    ('draw again: report', 'bag'),
)
"""What to do with the files of a run."""


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


@dataclass(frozen=True)
class _Option:
    """An option that is a parameter of the nodes by another name; how: for argparse."""

    parameter: str
    how: dict[str, Any]


_OPTIONS = {
    'sheep': _Option('sheep', {
        'type': _number(int, 1, MOST_SHEEP), 'metavar': 'N', 'help': 'number of sheep (30)',
    }),
    'dogs': _Option('dogs', {
        'type': _number(int, 1, MOST_DOGS), 'metavar': 'M', 'help': 'number of dogs (5)',
    }),
    'sigma': _Option('crowd.noise', {
        'type': _number(float, 0.0, LARGE), 'help': 'noise of the sheep (0.01)',
    }),
    'goal': _Option('goal', {
        'type': _number(float, -LARGE, LARGE), 'nargs': 2, 'metavar': ('X', 'Y'),
        'help': 'destination in metres (0.5 0.5); the flock starts around the origin',
    }),
    'seed': _Option('seed', {
        'type': _number(int, 0, 2**63 - 1), 'help': 'same seed, same run (0)',
    }),
    'strays': _Option('arrival.strays', {
        'type': _number(int, 0, MOST_STRAYS), 'metavar': 'K',
        'help': 'number of sheep that may be left behind (0)',
    }),
    'time-limit': _Option('time_limit', {
        'type': _number(float, TINY, LARGE), 'metavar': 'S',
        'help': 'simulated seconds to try (400)',
    }),
    'field': _Option('field', {
        'metavar': 'NAME', 'help': 'fences, obstacles, pens and the destination: '
        f'{", ".join(shipped_fields())} or a file; its parameters count less than all others',
    }),
}  # fmt: skip

_NODES = ('recorder', 'controller', 'sim')

_DEFAULTS = {'sheep': 30, 'dogs': 5, 'goal': GOAL, 'seed': 0, 'arrival.strays': 0,
             'time_limit': 400.0}  # fmt: skip
"""Parameters whose values herd needs to know itself."""

_EXCITING = 60.0
"""Usual length of a run that herds nowhere [s]."""

_OWN = {
    'lockstep', 'wait_for', 'stop_on_arrival', 'bag', 'use_sim_time', 'real_time_factor', 'excite',
}  # fmt: skip
"""Parameters that herd sets itself, whatever a file says."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='herd',
        description='Herd a flock: starts sim, controller and recorder as ROS 2 processes and '
        'ends when the flock is home and together. Writes bag/ (rosbag2, mcap), '
        'trajectories.png, summary.json and the logs of the nodes. All traffic stays on this '
        'machine, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set.',
        epilog='Exit code: 0 the flock arrived (with --excite: time is over), 1 it did not, '
        '2 bad arguments, 3 a process '
        'died, 130 interrupted by Ctrl-C. Example: herd --dogs 3 --goal 1 1 --seed 4',
    )
    add = parser.add_argument
    add(
        '--config', type=Path, action='append', default=[], metavar='FILE',
        help='parameter file of the nodes; of several the last one counts',
    )  # fmt: skip
    add(
        '-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE',
        help='a parameter of those nodes that have it; counts more than --config',
    )  # fmt: skip
    for name, option in _OPTIONS.items():
        add(f'--{name}', **option.how)
    add(
        '--real-time', type=_number(float, SLOWEST, FASTEST), metavar='FACTOR',
        help='run at FACTOR x real time instead of in lockstep, as fast as possible',
    )  # fmt: skip
    add(
        '--excite', action='store_true',
        help='herd nowhere: dogs run to and fro through the flock for --time-limit (60), so that '
        'fit can tell from the bag how sheep respond; not with --real-time',
    )  # fmt: skip
    add(
        '--view', action='store_true',
        help=f'show it in a browser, at {_VIEWED:g} x real time unless --real-time is given; it '
        'then goes on until Ctrl-C, so that a click can move the destination',
    )  # fmt: skip
    add(
        '--out', type=Path, metavar='DIR',
        help='where to write (runs/<time>); must not hold a bag yet',
    )  # fmt: skip
    return parser


def _values(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node, as files, assignments and options give them.

    An option counts more than an assignment, and that more than a file. Raises ValueError for what
    is not a parameter file, an assignment or a parameter.
    """
    files = [parameters_of(file) for file in options.config]
    assigned = dict(map(assignment, options.parameter))
    for name in assigned.keys() & _OWN:
        raise ValueError(f'{name} is set by herd itself; see herd --help')
    for name, option in _OPTIONS.items():
        value = getattr(options, name.replace('-', '_'))
        if value is not None:
            assigned[option.parameter] = value
    values, defaults = {}, dict(_DEFAULTS)
    if options.excite:
        defaults['time_limit'] = _EXCITING
    for node in (*_NODES, 'view'):
        given = {name: value for file in files for name, value in file(node, '').items()}
        given |= assigned
        values[node] = checked({**defaults, **_of_field(given), **given})
    return values


def _of_field(given: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters that go with the field of a node, its destination among them."""
    if not given.get('field'):
        return {}
    field, parameters = read_field(given['field'])
    if field.place is None:
        return parameters
    if 'goal' in given:
        raise ValueError(
            f'goal must not be given with a field that has one, such as {given["field"]}'
        )
    return {**parameters, 'goal': field.place.tolist()}


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
    # In lockstep the stamps are the time, and the clock would only wake the controller.
    own = {
        'lockstep': lockstep, 'wait_for': awaited(options.values['recorder']),
        'stop_on_arrival': not options.excite,
    }  # fmt: skip
    own_of = {
        'recorder': {'bag': options.out / 'bag', 'use_sim_time': True},
        'controller': {**own, 'use_sim_time': not lockstep, 'excite': options.excite},
        'sim': own,
    }
    defaults: dict[str, Any] = {}
    if not lockstep:
        own['real_time_factor'] = options.real_time
        fastest = max(options.real_time, _FASTEST_VIEWED) if options.view else options.real_time
        defaults['lead'] = lead_at(fastest)
    return [
        Child(node, {**defaults, **options.values[node], **own_of[node]}, logs) for node in _NODES
    ]


class _Viewing:
    """The view, without which a run goes on, and what there is to say of it."""

    def __init__(self, child: Child, watcher: Watcher, console: Console) -> None:
        self.child = child
        self._watcher = watcher
        self._console = console
        self._page = ''
        self._outcome = ''

    def goes_on(self) -> bool:
        """Say what is new; return whether the page is there to be used."""
        watcher, say = self._watcher, partial(self._console.print, markup=False, soft_wrap=True)
        if watcher.page != self._page:
            self._page = watcher.page
            say(f'watch it at {self._page}')
        if watcher.outcome != self._outcome:
            self._outcome = watcher.outcome
            if self._outcome:
                say(f'{self._outcome}; click on another destination, or end with Ctrl-C')
        if self.child.died:
            say(f'the view died (exit code {self.child.process.returncode}); the run goes on:')
            say(self.child.last_lines())
            return False
        return True


def _watch(
    children: list[Child],
    viewing: _Viewing | None,
    watcher: Watcher,
    interrupted: Noted,
    console: Console,
) -> int:
    """Show how it goes until it is over; return the exit code.

    With a view it is not over when the flock is home: a click may send it elsewhere.
    """
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
            if viewing and not viewing.goes_on():
                viewing = None
            over = watcher.finished and recorded and viewing is None
            over = over or bool(dead) or interrupted.is_set()
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
    return _ARRIVED if watcher.arrived else _TIMED_OUT


def _conclude(options: argparse.Namespace, code: int, outcome: str, console: Console) -> int:
    """Say how the run of a sim ended; return the exit code."""
    if code == _TIMED_OUT and options.excite:
        bag = shlex.quote(str(options.out / 'bag'))
        console.print(
            f'what it says of the sheep: ros2 run herding_ros fit {bag}', markup=False,
            soft_wrap=True,
        )  # fmt: skip
        return _ARRIVED
    if code == _TIMED_OUT:
        console.print(outcome, markup=False, soft_wrap=True)
    return code


def _run(options: argparse.Namespace, logs: Path, console: Console) -> int:
    """Run the nodes until it is over; return the exit code."""
    interrupted = note_signals()
    start_ros([])
    watcher = Watcher()
    children: list[Child] = []
    viewing = None
    try:
        children = _start_children(options, logs)
        if options.view:
            viewing = _Viewing(Child('view', options.values['view'], logs), watcher, console)
        code = _watch(children, viewing, watcher, interrupted, console)
        code = _conclude(options, code, watcher.outcome, console)
    finally:
        if viewing:
            viewing.child.end()
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
    try:
        options.values = _values(options)
    except ValueError as error:
        parser.error(str(error))
    sim = options.values['sim']
    sheep, strays = sim['sheep'], sim['arrival.strays']
    if not strays < sheep:
        parser.error(f'argument --strays: must be less than --sheep, {sheep}, got {strays}')
    if options.excite and (options.view or options.real_time is not None):
        parser.error(
            'argument --excite: must not be given with --real-time or --view: it is in lockstep'
        )
    if options.view and options.real_time is None:
        options.real_time = _VIEWED
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
    where = f'to ({sim["goal"][0]:g}, {sim["goal"][1]:g})'
    if options.excite:
        where = f'nowhere, for {sim["time_limit"]:g} s,'
    console.print(
        f'herding {sheep} sheep with {sim["dogs"]} dogs {where} on ROS_DOMAIN_ID '
        f'{os.environ.get("ROS_DOMAIN_ID", "0")}; output in {options.out}',
        soft_wrap=True,
    )
    if names := sorted(set().union(*options.values.values()) & _OWN - {'use_sim_time'}):
        console.print(f'herd itself sets {", ".join(names)}: what a file says does not count')
    if not has_kernels():
        console.print('kernels are compiled first, once, for up to a minute; see log/')
    code = _run(options, logs, console)
    if (options.out / 'bag').exists():
        from herding_ros.report.cli import write_report  # it takes a second to load: not before

        try:
            write_report(options.out / 'bag', options.out, console)
        except (OSError, ValueError) as error:
            console.print(f'no report: {error}', style='red', soft_wrap=True)
    if code in (_ARRIVED, _TIMED_OUT):
        _tell_what_next(options, code, console)
    return code


def _tell_what_next(options: argparse.Namespace, code: int, console: Console) -> None:
    """Say what to do after a run, in lines for 40 columns where the folder's name is short."""
    folder = min(os.path.relpath(options.out), str(options.out), key=len)
    lines = [f'{what} {folder}/{name}' for what, name in _NEXT if (options.out / name).exists()]
    if code == _TIMED_OUT:
        lines.append('why flocks do not arrive: doc/troubleshooting.md')
    lines.append(f'another flock: --seed {options.values["sim"]["seed"] + 1}')
    console.print(
        'next:', *(f'  {line}' for line in lines), sep='\n', markup=False, soft_wrap=True
    )


if __name__ == '__main__':
    sys.exit(main())
