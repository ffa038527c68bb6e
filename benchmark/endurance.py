# SPDX-License-Identifier: Apache-2.0
"""Long recorded runs: memory, pace, losses, deadlines and the jitter of the commands.

    python -m benchmark.endurance --out build/endurance                      an hour in lockstep
    python -m benchmark.endurance --minutes 10 --real-time 10 --sheep 30 --dogs 5

Writes endurance.json and endurance.png beside the bag. The flock is driven home and kept there.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import re
import sys
import time
from typing import Any

from herding_ros.bag.metadata import read_metadata
from herding_ros.control.lead import lead_at
from herding_ros.control.parameters import Horizon
from herding_ros.nodes.middleware import start_ros
from herding_ros.nodes.progress import Watcher
from herding_ros.nodes.supervision import Child
from herding_ros.report.style import legend, new, save
from mcap.reader import make_reader
import numpy as np
from numpy.typing import NDArray
import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console
from rosbags.highlevel import AnyReader

WARM_UP = 0.1
"""Share of a run that is not judged: caches fill, the recorder discovers the topics."""

_FILE_SIZE = 50_000_000
"""Size of a file of the bag [byte]. The index of an open file is kept in memory."""

_SAMPLE_PERIOD = 1.0
_PUBLISHED = re.compile(r'(\d+) on (/[\w/]+)')


@dataclass(frozen=True)
class Endured:
    """The course of a run.

    wall: (T,) wall time of each sample [s]; simulated: (T,) [s]; memory: resident memory by node,
    (T,) each [MB]; lost: messages that were published and are not in the bag, by topic;
    margins: (windows,) time by which each plan was ready before its window [s], negative when it
    was late; jitter: deviation of the time between two commands of a dog from the control period.
    """

    wall: list[float]
    simulated: list[float]
    memory: dict[str, list[float]]
    messages: int
    lost: dict[str, int]
    margins: list[float]
    jitter: dict[str, float]

    def growth(self, node: str) -> tuple[float, float]:
        """Growth of a node's memory in the part that is judged, and its noise [MB].

        Growth is the difference between the means of the last and the first third, noise the
        standard deviation about a straight line.
        """
        memory = self._judged(self.memory[node])
        third = len(memory) // 3
        steps = np.arange(len(memory))
        line = np.polyval(np.polyfit(steps, memory, 1), steps)
        return float(memory[-third:].mean() - memory[:third].mean()), float(np.std(memory - line))

    def pace(self) -> tuple[float, float]:
        """Simulated seconds a second in the first and in the last third of what is judged."""
        wall, simulated = self._judged(self.wall), self._judged(self.simulated)
        third = len(wall) // 3
        first, last = slice(0, third + 1), slice(-third - 1, None)
        return tuple(np.ptp(simulated[part]) / np.ptp(wall[part]) for part in (first, last))  # type: ignore[return-value]

    def _judged(self, series: list[float]) -> NDArray[np.float64]:
        return np.array(series[int(WARM_UP * len(series)) :])


def endure(
    out: Path, seconds: float, sheep: int, dogs: int, real_time: float | None, console: Console
) -> Endured:
    """Herd for so many simulated seconds, in lockstep or at a multiple of real time."""
    out.mkdir(parents=True, exist_ok=True)
    lockstep = real_time is None
    shared: dict[str, object] = {'dogs': dogs, 'lockstep': lockstep, 'wait_for': 'recorder'}
    sim: dict[str, object] = {**shared, 'sheep': sheep, 'time_limit': seconds}
    controller: dict[str, object] = {**shared, 'use_sim_time': not lockstep}
    recorder = {'bag': out / 'bag', 'use_sim_time': True, 'max_bag_size': _FILE_SIZE}
    if real_time is not None:
        sim['real_time_factor'] = real_time
        controller['lead'] = lead_at(real_time)
    children = [
        Child('recorder', recorder, out),
        Child('controller', controller, out),
        Child('sim', sim, out),
    ]
    start_ros([])
    watcher = Watcher()
    executor = SingleThreadedExecutor()
    executor.add_node(watcher)
    wall: list[float] = []
    simulated: list[float] = []
    memory: dict[str, list[float]] = {child.name: [] for child in children}
    begun = sampled = time.monotonic()
    try:
        while not watcher.finished:
            executor.spin_once(timeout_sec=0.1)
            dead = [child for child in children if child.process.poll() is not None]
            if dead:
                raise RuntimeError(f'{dead[0].name} died:\n{dead[0].last_lines()}')
            now = time.monotonic()
            if now < sampled + _SAMPLE_PERIOD or not watcher.sim:
                continue
            sampled = now
            wall.append(now - begun)
            simulated.append(watcher.time)
            for child in children:
                resident = psutil.Process(child.process.pid).memory_info().rss
                memory[child.name].append(resident / 1e6)
            if len(wall) % 10 == 0:
                console.print(f'{watcher.time:.0f} of {seconds:.0f} s, {now - begun:.0f} s wall')
    finally:
        for child in reversed(children):
            child.end()
        watcher.destroy_node()
        rclpy.shutdown()
    lost, messages = _lost(out, children)
    margins = _deadlines(out / 'bag')
    jitter = (
        _jitter(out / 'bag', Horizon().control_period / real_time) if real_time is not None else {}
    )
    return Endured(wall, simulated, memory, messages, lost, margins, jitter)


def _lost(out: Path, children: list[Child]) -> tuple[dict[str, int], int]:
    """Return the messages that were published but are not in the bag, and its size."""
    metadata = read_metadata(out / 'bag')
    recorded = {
        topic['topic_metadata']['name']: topic['message_count']
        for topic in metadata['topics_with_message_count']
    }
    lost = {}
    for child in children:
        said = [line for line in child.log.read_text().splitlines() if '] published ' in line]
        for count, topic in _PUBLISHED.findall(said[-1] if said else ''):
            # /diagnostics has several publishers, the recorder itself among them.
            if topic != '/diagnostics' and int(count) != recorded.get(topic, 0):
                lost[topic] = int(count) - recorded.get(topic, 0)
    return lost, metadata['message_count']


def _deadlines(bag: Path) -> list[float]:
    """Return the time from the completion of each window's plan to its start [s]."""
    margins = []
    with AnyReader([bag]) as reader:
        of_diagnostics = [c for c in reader.connections if c.topic == '/diagnostics']
        for connection, _, data in reader.messages(of_diagnostics):
            message: Any = reader.deserialize(data, connection.msgtype)
            values = {pair.key: pair.value for pair in message.status[0].values}
            if message.status[0].name == 'controller: plan' and values['kind'] == 'window':
                margins.append(float(values['deadline_margin_s']))
    return margins


def _jitter(bag: Path, period: float) -> dict[str, float]:
    """Return percentiles of the deviation of the time between two commands [ms]."""
    stamps: list[int] = []
    for file in bag.glob('*.mcap'):
        with file.open('rb') as stream:
            commands = make_reader(stream).iter_messages(['/dog_1/cmd_vel'])
            stamps += [message.publish_time for _, _, message in commands]
    off = 1e3 * np.abs(np.diff(np.array(sorted(stamps))) * 1e-9 - period)
    p50, p99, most = np.percentile(off, [50, 99, 100])
    return {'period_ms': 1e3 * period, 'p50_ms': p50, 'p99_ms': p99, 'max_ms': most}


def draw(endured: Endured, path: Path) -> None:
    """Memory of each node and simulated seconds a second over wall time, as PNG."""
    figure, ((left, right),) = new(2, 1, width=4.5, height=3.2)
    for name, memory in endured.memory.items():
        left.plot(endured.wall, memory, label=name)
    left.set(xlabel='wall time [s]', ylabel='resident memory [MB]')
    left.set_ylim(bottom=0)
    legend(left)
    pace = np.diff(endured.simulated) / np.diff(endured.wall)
    width = max(len(pace) // 60, 1)
    smooth = np.convolve(pace, np.ones(width) / width, 'valid')
    right.plot(endured.wall[width:][: len(smooth)], smooth)
    right.set(xlabel='wall time [s]', ylabel='simulated seconds a second')
    right.set_ylim(bottom=0)
    save(figure, path)


def summary(endured: Endured) -> dict[str, Any]:
    """Return the result of a run."""
    return {
        'simulated_s': endured.simulated[-1],
        'wall_s': round(endured.wall[-1], 1),
        'messages': endured.messages,
        'lost': endured.lost,
        'growth_and_noise_mb': {
            name: [round(value, 2) for value in endured.growth(name)] for name in endured.memory
        },
        'pace_first_and_last_third': [round(value, 2) for value in endured.pace()],
        'plans': len(endured.margins),
        'deadlines_missed': sum(margin < 0.0 for margin in endured.margins),
        'least_margin_s': round(min(endured.margins), 3),
        'jitter': endured.jitter,
    }


def main(args: list[str] | None = None) -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(
        prog='endurance', description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument('--minutes', type=float, default=60.0, help='simulated time (60)')
    parser.add_argument('--sheep', type=int, default=100, help='number of sheep (100)')
    parser.add_argument('--dogs', type=int, default=6, help='number of dogs (6)')
    parser.add_argument('--real-time', type=float, help='multiple of real time, not in lockstep')
    parser.add_argument('--out', type=Path, required=True, help='folder, without a bag in it')
    given = parser.parse_args(args)
    console = Console(highlight=False)
    endured = endure(
        given.out, 60.0 * given.minutes, given.sheep, given.dogs, given.real_time, console
    )
    said = summary(endured)
    (given.out / 'endurance.json').write_text(json.dumps({**said, **asdict(endured)}, indent=1))
    draw(endured, given.out / 'endurance.png')
    console.print_json(json.dumps(said))
    return 0


if __name__ == '__main__':
    sys.exit(main())
