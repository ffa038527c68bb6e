# SPDX-License-Identifier: Apache-2.0
"""The log times of a recording: when messages came in, by the simulation's clock if any."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
import shutil
from tempfile import mkdtemp

from herding_ros.bag.writer import BagWriter, LAST_TIME_NS
from mcap.reader import make_reader

from .refusals import Refused
from .wire import Reader


class LogClock:
    """The time of a simulation as its messages on /clock give it; it never goes back.

    A reset of the simulation sets its clock back; a bag whose times went back as well would play
    both runs at once.
    """

    def __init__(self) -> None:
        self._clock_ns: int | None = None  # the last /clock
        self._time_ns = 0

    @property
    def is_known(self) -> bool:
        """Whether there has been a /clock."""
        return self._clock_ns is not None

    def follow(self, data: bytes) -> None:
        """Take a serialised message of /clock; raises Refused when it is not a time."""
        seconds, nanoseconds = Reader(data).numbers('iI')
        if seconds < 0 or nanoseconds >= 1_000_000_000:
            raise Refused('no time', f'{seconds} s and {nanoseconds} ns are not a time')
        clock_ns = int(seconds * 1_000_000_000 + nanoseconds)
        last_ns = 0 if self._clock_ns is None else self._clock_ns
        self._time_ns = min(self._time_ns + max(clock_ns - last_ns, 0), LAST_TIME_NS)
        self._clock_ns = clock_ns

    def log_time(self, receive_ns: int) -> int:
        """Return the log time [ns] of a message that came in at this wall time [ns]."""
        return self._time_ns if self.is_known else receive_ns


def rewritten(bag: BagWriter, create: Callable[[], BagWriter], log_ns: int) -> BagWriter:
    """Return a bag by `create` in place of one, with the same messages at another log time [ns].

    Meanwhile the old one, complete, is beside it as `<name>.before_clock_<letters>`; a kill leaves
    it there. When the disk refuses (OSError) it is where it was.
    """
    bag.close()
    early = Path(mkdtemp(prefix=bag.path.name + '.before_clock_', dir=bag.path.parent))
    bag.path.rename(early)
    try:
        new = create()
        for topic in bag.added_topics:
            new.add_topic(*topic)
        files = [early / f'{bag.path.name}_{k}.mcap' for k in range(bag.file_count)]
        for name, data, publish_ns in _messages(files):
            new.write(name, data, log_ns, publish_ns)
        new.flush()
    except OSError:
        shutil.rmtree(bag.path, ignore_errors=True)
        early.rename(bag.path)
        raise
    shutil.rmtree(early)
    return new


def _messages(files: Iterable[Path]) -> Iterator[tuple[str, bytes, int]]:
    """Yield topic, data and publish time [ns] of all messages, in the order of the files."""
    for file in files:
        with file.open('rb') as stream:
            found = make_reader(stream).iter_messages(log_time_order=False)
            yield from (
                (each.topic, message.data, message.publish_time) for _, each, message in found
            )
