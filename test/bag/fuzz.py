# SPDX-License-Identifier: Apache-2.0
"""Damages a bag in many ways, and looks how `recover` and the reader of reports take each.

usage: fuzz.py BAG WORK FIRST COUNT
       fuzz.py cost BAG...

Reads BAG, of one data file, and works in the new folder WORK. Each number from FIRST on is the
seed of another damage. With `cost` it looks only at what the bags cost.

It has a process of its own, so that its memory is that of the programs alone. Prints what must
not be, a line each, and at the end the peak of its memory [MB].
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import random
import re
import shutil
import sys
import time
import traceback
from typing import Any

from herding_ros.bag.metadata import FILE_NAME
from herding_ros.bag.reader import read_run
from herding_ros.bag.recovery import recover
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

SECONDS = 1.0
"""What each call may take, and as much again for each MB of the bag [s of processor time]."""

WORDS = [
    *('', '[]', '{}', '~', 'null', 'true', '-1', '1.5e999', '99999999999999999999', '[[[[', '"'),
    *('&a [*a]', '!!python/name:os.system', '{a: {b: [1, 2]}}', '"\\0"', 'x' * 5000, '- - -'),
    *('../x', '/etc/passwd', '"\\ud800"', 'é' * 300, '0x7f', '1:1:1', '2000-01-01', '<<', '? {}'),
]

Damage = Callable[[random.Random, bytes], bytes]


def flip_bits(chance: random.Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def cut_off(chance: random.Random, data: bytes) -> bytes:
    return data[: chance.randrange(len(data))] + bytes(chance.choice((0, 0, 5000)))


def take_out(chance: random.Random, data: bytes) -> bytes:
    place = chance.randrange(len(data))
    return data[:place] + data[place + chance.choice((1, 9, 1000)) :]


def insert(chance: random.Random, data: bytes) -> bytes:
    place, other = chance.randrange(len(data)), chance.randrange(len(data))
    new = chance.choice((bytes(100), chance.randbytes(50), data[other : other + 5000]))
    return data[:place] + new + data[place:]


def change_lengths(chance: random.Random, data: bytes) -> bytes:
    """Some number of four or eight bytes becomes another; most of the small ones are lengths."""
    changed = bytearray(data)
    zeros = [match.start() for match in re.finditer(b'\0\0\0', data)]
    for _ in range(chance.choice((1, 3))):
        place, size = max(chance.choice(zeros) - 1, 0), chance.choice((4, 8))
        number = chance.choice((0, 1, 2**16, 2**24, 2**31, 2**32 - 1, chance.getrandbits(63)))
        changed[place : place + size] = (number % 2 ** (8 * size)).to_bytes(size, 'little')
    return bytes(changed)


def splice_records(chance: random.Random, data: bytes) -> bytes:
    """Whole records are left out, doubled or moved."""
    pieces, place = [], 8
    while place < len(data) - 8:
        end = place + 9 + int.from_bytes(data[place + 1 : place + 9], 'little')
        pieces.append(data[place:end])
        place = end
    for _ in range(chance.choice((1, 2, 5))):
        piece = pieces.pop(chance.randrange(len(pieces)))
        for _ in range(chance.choice((0, 1, 2))):
            pieces.insert(chance.randrange(len(pieces) + 1), piece)
    return data[:8] + b''.join(pieces) + data[-8:]


def change_values(chance: random.Random, data: bytes) -> bytes:
    """Some values of a YAML map become others, keys vanish, lines are doubled."""
    lines = data.decode(errors='replace').splitlines()
    for _ in range(chance.choice((1, 1, 3))):
        lines = lines or ['']
        number = chance.randrange(len(lines))
        key, colon, _ = lines[number].partition(':')
        changed = f'{key}{colon} {chance.choice(WORDS)}'
        lines[number : number + 1] = chance.choice(([], [changed], [changed], [lines[number]] * 2))
    return '\n'.join(lines).encode()


def write_anew(chance: random.Random, path: Path) -> None:
    """Write a file again as another recorder might, where any text may be anything."""
    with path.open('rb') as stream:
        found = list(make_reader(stream).iter_messages(log_time_order=False))

    def text(right: str) -> str:
        if chance.random() > 0.03:
            return right
        return chance.choice((*WORDS, change_values(chance, f'{right} '.encode()).decode()))

    with path.open('wb') as stream:
        writer = Writer(
            stream,
            chunk_size=chance.choice((1, 5000, 2**20)),
            compression=chance.choice(list(CompressionType)),
            use_chunking=chance.random() < 0.7,
            use_statistics=chance.random() < 0.9,
            repeat_channels=chance.random() < 0.9,
            enable_crcs=chance.random() < 0.5,
        )
        writer.start(profile=text('ros2'))
        channels: dict[int, int] = {}
        for schema, channel, message in found:
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(
                    text(schema.name), text(schema.encoding), text(schema.data.decode()).encode()
                )
                said = {text(key): text(value) for key, value in channel.metadata.items()}
                channels[channel.id] = writer.register_channel(
                    text(channel.topic), text(channel.message_encoding), number, said
                )
            time_ns, data = message.log_time, message.data
            if chance.random() < 0.01:
                time_ns = chance.choice((0, 2**63, 2**64 - 1))
                data = chance.choice((cut_off, flip_bits, change_lengths))(chance, data + bytes(3))
            writer.add_message(channels[channel.id], time_ns, data, chance.choice((0, time_ns)))
        writer.add_metadata('rosbag2', {text('serialized_metadata'): chance.choice(WORDS)})
        writer.finish()


OF_FILES: list[Damage] = [
    *(flip_bits, flip_bits, cut_off, take_out, insert, change_lengths, splice_records),
]


def damage(chance: random.Random, folder: Path) -> None:
    (file,) = folder.glob('*.mcap')
    if chance.random() < 0.4:
        write_anew(chance, file)
    if chance.random() < 0.6:
        file.write_bytes(chance.choice(OF_FILES)(chance, file.read_bytes()))
    metadata = folder / FILE_NAME
    kind = chance.random()
    if kind < 0.3:
        way = chance.choice((change_values, change_values, flip_bits, cut_off))
        metadata.write_bytes(way(chance, metadata.read_bytes()))
    elif kind < 0.4:
        metadata.unlink()


def attempt(call: Callable[[Path], Any], folder: Path, most: float) -> tuple[Any, str]:
    """Return what a call returned, if anything, and what was wrong with it, if anything."""
    begin = time.process_time()
    result, wrong = None, ''
    try:
        result = call(folder)
    except (OSError, ValueError) as error:
        if not str(error) or '\n' in str(error):
            wrong = f'a message of no or many lines: {error}'
    except Exception:
        wrong = traceback.format_exc()
    took = time.process_time() - begin
    return result, wrong or (f'it took {took:.2f} s' if took > most else '')


def cost(folder: Path) -> tuple[float, Any, list[str]]:
    """Return what each call may take [s], what `recover` found, and what was wrong."""
    most = SECONDS * (1.0 + sum(file.stat().st_size for file in folder.iterdir()) * 1e-6)
    _, wrong = attempt(read_run, folder, most)
    recovery, also_wrong = attempt(recover, folder, most)
    return most, recovery, [each for each in (wrong, also_wrong) if each]


def check(folder: Path) -> list[str]:
    """Return what is wrong with what the programs make of a bag."""
    most, recovery, found = cost(folder)
    if recovery:
        found.append(attempt(read_run, folder, most)[1])
        count = 0
        for file in recovery.files:
            with file.path.open('rb') as stream:
                count += sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
            with file.path.open('rb') as stream:
                list(StreamReader(stream, validate_crcs=True).records)
        expected = sum(file.information.message_count for file in recovery.files)
        if count != expected:
            found.append(f'{count} messages can be read, not {expected}')
        again, wrong = attempt(recover, folder, most)
        if again is None or not again.was_whole:
            found.append(f'not whole after it was recovered: {again} {wrong}')
    return [wrong for wrong in found if wrong]


def main() -> None:
    if sys.argv[1] == 'cost':
        for folder in map(Path, sys.argv[2:]):
            for wrong in cost(folder)[2]:
                print(f'{folder.name}: {wrong}')
    else:
        bag, work = Path(sys.argv[1]), Path(sys.argv[2])
        first, count = int(sys.argv[3]), int(sys.argv[4])
        for seed in range(first, first + count):
            shutil.copytree(bag, work)
            damage(random.Random(seed), work)
            for wrong in check(work):
                print(f'seed {seed}: {wrong}')
            shutil.rmtree(work)
    peak = re.search(r'VmHWM:\s+([0-9]+) kB', Path('/proc/self/status').read_text())
    assert peak is not None
    print(f'{int(peak[1]) // 1024} MB')


if __name__ == '__main__':
    main()
