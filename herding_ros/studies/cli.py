# SPDX-License-Identifier: Apache-2.0
"""The program `study`: regenerates the paper's tables and figures, and ours."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
import os
from pathlib import Path
import signal
import sys
import time

from herding_ros.model.kernel_cache import has_kernels
from herding_ros.model.parameters import LARGE
from herding_ros.programs import INTERRUPTED
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from .reproduction import FURTHER, page, single, STUDIES
from .runner import compute, Outcome
from .store import Store
from .study import Options, Results
from .task import Task

_DONE, _FAILED, _BAD_ARGUMENTS = 0, 1, 2
_LINE_EVERY = 10.0
"""Time between two lines of progress without a terminal [s]."""


def _positive(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be an integer of at least 1, got {text}')
    return value


def _noise(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= LARGE:
        raise argparse.ArgumentTypeError(
            f'must be a number above 0, at most {LARGE:g}, got {text}'
        )
    return value


def _parser() -> argparse.ArgumentParser:
    names = '\n'.join(f'  {name:15}{study.DESCRIPTION}' for name, study in STUDIES.items())
    parser = argparse.ArgumentParser(
        prog='study',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description=(
            "Regenerate the paper's tables and figures, and what goes beyond them.\n\n"
            f'studies:\n{names}\n  {"all":15}all of these, and the pages about them\n\n'
            'A study is a list of tasks. Each result is stored as soon as it is computed, so\n'
            'that an interrupted study resumes where it stopped, and nothing is computed twice:\n'
            'with all results stored, a study only draws. Results of other versions of the\n'
            'computing code are never used.'
        ),
        epilog=(
            'examples:\n'
            '  study symmetry                         a minute; writes studies/symmetry.md\n'
            '  study real sheep_drives.npz            fits recordings, too\n'
            '  study dogs --seeds 5                   a quarter of it\n'
            '  study all --quick --out /tmp/try       test that everything works\n'
            '  study all --results studies/results --out doc\n'
            '  study all --scheduler tcp://host:8786  on a Dask cluster\n\n'
            'exit code: 0 done, 1 a task failed, 2 bad arguments, 130 interrupted by Ctrl-C'
        ),
    )
    add = parser.add_argument
    add('name', nargs='?', choices=[*STUDIES, 'all'], metavar='NAME', help='the study, or all')
    add(
        'data', nargs='?', type=Path, metavar='DATA',
        help='file of recordings, for real: the page says where they are published',
    )  # fmt: skip
    add('--list', action='store_true', help='list the studies with their sizes and exit')
    add('--seeds', type=_positive, metavar='N', help='use the seeds 0 to N - 1')
    add('--paths', type=_positive, metavar='N', help='Monte Carlo paths of a plan (100)')
    add(
        '--sigma', type=_noise, nargs='+', metavar='S',
        help='strengths of the noise, of studies that vary it (0.01 0.02 0.03 0.04)',
    )  # fmt: skip
    add(
        '--jobs', type=_positive, metavar='N', default=len(os.sched_getaffinity(0)),
        help='number of worker processes (one per core)',
    )  # fmt: skip
    add(
        '--scheduler', metavar='ADDRESS',
        help='compute on the workers of this Dask scheduler, with the same herding_ros installed; '
        'scheduler and workers run whatever anyone who reaches them sends',
    )  # fmt: skip
    add(
        '--out', type=Path, metavar='DIR', default=Path('studies'),
        help='folder for pages and figures (studies)',
    )  # fmt: skip
    add('--results', type=Path, metavar='DIR', help='folder of the results (DIR of --out/results)')
    add('--quick', action='store_true', help='tiny sizes, to test that everything works')
    add('--draw', action='store_true', help='compute nothing, draw the stored results')
    return parser


def main(args: list[str] | None = None) -> int:
    """Run the program; see --help for the exit codes."""
    parser = _parser()
    given = parser.parse_args(args)
    sigmas = given.sigma and tuple(dict.fromkeys(given.sigma))
    options = Options(given.seeds, given.paths, given.quick, sigmas, given.data)
    console = Console(highlight=False, soft_wrap=True)
    if given.list:
        _list(options, console)
        return _DONE
    if given.name is None:
        parser.error(f'NAME must be one of {", ".join([*STUDIES, "all"])}')
    names = list(STUDIES) if given.name == 'all' else [given.name]
    store = Store(given.results or given.out / 'results')
    try:
        tasks_of = {name: STUDIES[name].tasks(options) for name in names}
    except (OSError, ValueError) as error:
        parser.error(str(error))
    for idle in options.idle:
        option = 'DATA' if idle == 'data' else f'--{idle}'
        parser.error(f'{option} must not be given: {given.name} has none to choose')
    # Both act as Ctrl-C, which a shell ignores in processes that it starts in the background.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        given.out.mkdir(parents=True, exist_ok=True)
        failed = 0
        if not given.draw:
            every = {task.key: task for tasks in tasks_of.values() for task in tasks}
            todo = [task for task in every.values() if store.load(task) is None]
            done = len(every) - len(todo)
            console.print(
                f'{len(every)} tasks, {done} of them already done, about '
                f'{_duration(sum(task.cost for task in todo))} of one core left; '
                f'results in {store.folder}'
            )
            without = [task for task in todo if not task.is_possible]
            todo = [task for task in todo if task.is_possible]
            if without:
                console.print(
                    f'{len(without)} tasks are left out, since they need DATA: study real DATA; '
                    'its page says where the data are published'
                )
            if todo and not has_kernels():
                console.print('kernels are compiled first, once, for up to a minute')
            if todo:
                failed = _compute(todo, store, console, given.jobs, given.scheduler)
        _write(given.name, tasks_of, store, given.out, console)
        console.print(f'next: look at the pages, and the figures in {given.out}/figures')
        if given.quick:
            usual = Options(given.seeds, given.paths, sigma=sigmas)
            cost = sum(task.cost for name in names for task in STUDIES[name].tasks(usual))
            console.print(f'these sizes are tiny; without --quick: {_duration(cost)} of one core')
    except KeyboardInterrupt:
        console.print('interrupted; all results so far are stored, and the same command resumes')
        return INTERRUPTED
    except (OSError, RuntimeError) as error:
        print(f'study: {error}', file=sys.stderr)
        return _BAD_ARGUMENTS if isinstance(error, OSError) else _FAILED
    return _FAILED if failed else _DONE


def _list(options: Options, console: Console) -> None:
    for name, study in STUDIES.items():
        tasks = study.tasks(options)
        cost = _duration(sum(task.cost for task in tasks))
        console.print(f'{name:15}{study.DESCRIPTION} ({len(tasks)} tasks, {cost} of one core)')


def _compute(
    todo: Sequence[Task], store: Store, console: Console, jobs: int, scheduler: str | None
) -> int:
    """Compute tasks and store their results; return the number of failures."""
    # The longest first, so that at the end no core waits for a long task.
    todo = sorted(todo, key=lambda task: -task.cost)
    all_cost, cost, failures = sum(task.cost for task in todo), 0.0, 0
    begun = shown = time.monotonic()
    with Progress(
        BarColumn(), TextColumn('{task.description}'), TimeElapsedColumn(),
        console=console, disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        line = bar.add_task(f'0 of {len(todo)}', total=all_cost)
        for count, outcome in enumerate(compute(todo, jobs, scheduler), 1):
            failures += not _keep(outcome, store, console)
            cost += outcome.task.cost
            now = time.monotonic()
            left = (now - begun) * (all_cost - cost) / cost
            words = f'{count} of {len(todo)}, about {_duration(left)} left'
            bar.update(line, completed=cost, description=words)
            if not console.is_terminal and (now - shown > _LINE_EVERY or count == len(todo)):
                shown = now
                console.print(words)
    if failures:
        console.print(f'{failures} of {len(todo)} tasks failed', style='red')
    return failures


def _keep(outcome: Outcome, store: Store, console: Console) -> bool:
    """Store a result, or print the error; return whether there is a result."""
    task, error = outcome.task, outcome.error
    if outcome.result is not None:
        try:
            store.keep(task, outcome.result, outcome.seconds)
        except ValueError as refusal:
            error = f'the result cannot be stored: {refusal}'
    if error:
        console.print(f'failed: {task.kind} {task.parameters}', style='red', markup=False)
        console.print(error, markup=False)
    return not error


def _write(
    name: str, tasks_of: dict[str, list[Task]], store: Store, out: Path, console: Console
) -> None:
    """Draw the stored results, and write the page of a study, or all pages."""
    sections, missing = {}, 0
    for each, tasks in tasks_of.items():
        loaded = [(task, store.load(task)) for task in tasks]
        found = [(task, result) for task, result in loaded if result is not None]
        missing += len(loaded) - len(found)
        sections[each] = STUDIES[each].draw(Results(found), out / 'figures')
    if missing:
        console.print(f'{missing} results are missing from the pages', style='red')
    if name == 'all':
        pages = {each: single(each, sections[each]) for each in FURTHER}
        pages['reproduction'] = page(sections)
    else:
        pages = {name: single(name, sections[name])}
    for each, content in pages.items():
        path = out / f'{each}.md'
        path.write_text(content, encoding='utf-8')
        console.print(f'written: {path}')


def _duration(seconds: float) -> str:
    """Return a time in a suitable unit."""
    if seconds < 90.0:
        return f'{seconds:.0f} s'
    return f'{seconds / 60.0:.0f} min' if seconds < 5400.0 else f'{seconds / 3600.0:.1f} h'


if __name__ == '__main__':
    sys.exit(main())
