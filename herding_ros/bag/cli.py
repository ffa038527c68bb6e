# SPDX-License-Identifier: Apache-2.0
"""The program `recover`: makes a bag readable whose recorder was killed, or that was damaged."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

from rich.console import Console
from rich.progress import Progress

from .inspection import Inspection
from .metadata import FILE_NAME, total_counts
from .recovery import BROKEN, recover, Recovery

_DESCRIPTION = """\
Make a rosbag2 bag in mcap readable that has no end, since its recorder was killed or the power
failed, or that was damaged. What is intact is kept, and metadata.yaml is rewritten.

A data file that is whole is left alone. One that is not is copied up to where its records end,
without the chunks that are damaged, and then kept as NAME.mcap.broken: delete that when you are
content. So the disk needs room for a copy. Nothing is ever overwritten, and nothing outside of
BAG is touched.
"""

_EPILOG = """\
Exit code: 0 the bag is whole now, or was; 2 it is not a bag, is being recorded or cannot be
written.
Bags of `ros2 bag record -s mcap` are recovered too, those in sqlite3 are not.
Example: recover runs/2025-01-31_12-00-00/bag
"""


def main(args: list[str] | None = None) -> int:
    """Run the program. Returns 0, or 2 when there is no bag or it cannot be written."""
    parser = argparse.ArgumentParser(
        prog='recover',
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2 bag')
    options = parser.parse_args(args)
    try:
        recovery = _recover(options.bag)
    except (OSError, ValueError) as error:
        print(f'recover: {error}', file=sys.stderr)
        return 2
    print(_in_words(options.bag, recovery))
    return 0


def _recover(folder: Path) -> Recovery:
    """Recover a bag; on a terminal a bar shows how far it is."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        return recover(folder, lambda path: bar.open(path, 'rb', description=path.name))


def _in_words(folder: Path, recovery: Recovery) -> str:
    files = [file.information for file in recovery.files]
    lines = [_line(file) for file in recovery.files]
    count = sum(file.message_count for file in files)
    total = f'{count} messages of {len(total_counts(files))} topics'
    if recovery.was_whole:
        lines.append(f'{folder} was whole: {total}; nothing was changed')
    else:
        lines.append(f'{folder} is whole: {total}')
    if recovery.new_metadata:
        lines[-1] += f', {FILE_NAME} is new'
    return '\n'.join(lines)


def _line(file: Inspection) -> str:
    name, count = file.path.name, file.information.message_count
    if not file.faults:
        return f'{name}: whole, {count} messages'
    recovered = f'{count} messages recovered; the original is {name}{BROKEN}'
    return '\n    '.join([f'{name}: {recovered}', *file.faults])


if __name__ == '__main__':
    sys.exit(main())
