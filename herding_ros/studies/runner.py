# SPDX-License-Identifier: Apache-2.0
"""Computes tasks in this process, in several on this machine, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed, ProcessPoolExecutor
from dataclasses import dataclass
import importlib
import logging
import multiprocessing
import signal
import time
import traceback

from .experiments import EXPERIMENTS
from .store import Result
from .task import Task


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task: a result or, if that is None, an error."""

    task: Task
    result: Result | None
    seconds: float
    error: str = ''


def work(task: Task, key: str) -> Outcome:
    """Compute a task; its error, if any, is part of the outcome. Runs in the workers.

    key: the task's key in the calling process, which differs if a worker has other code.
    """
    started = time.perf_counter()
    result, error = None, ''
    try:
        if task.key != key:
            raise RuntimeError('this worker has another version of herding_ros than the caller')
        result = EXPERIMENTS[task.kind](**task.parameters, **task.inputs)
    except Exception:
        error = traceback.format_exc()
    return Outcome(task, result, time.perf_counter() - started, error)


def compute(tasks: Sequence[Task], jobs: int, scheduler: str | None) -> Iterator[Outcome]:
    """Yield the outcome of each task as soon as it is known, in any order.

    The workers of a Dask scheduler compute if its address is given, else `jobs` processes.
    """
    if scheduler is not None:
        return _on_cluster(tasks, scheduler)
    if jobs == 1 or len(tasks) < 2:
        return (work(task, task.key) for task in tasks)
    return _in_processes(tasks, min(jobs, len(tasks)))


def _in_processes(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    others = set(multiprocessing.active_children())
    # Not forked: a fork copies the locks of threads that it does not copy.
    pool = ProcessPoolExecutor(
        jobs, multiprocessing.get_context('spawn'), initializer=_begin_worker
    )
    try:
        futures = [pool.submit(work, task, task.key) for task in tasks]
        for future in as_completed(futures):
            yield future.result()
        pool.shutdown()
    except BaseException:
        # Ctrl-C, or the caller stops. A task may take minutes: do not wait for its worker.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise


def _begin_worker() -> None:
    # Ctrl-C in a terminal reaches all processes at once: the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What controllers say in a thousand runs would bury the progress.
    logging.getLogger('herding_ros.control').setLevel(logging.ERROR)


def _on_cluster(tasks: Sequence[Task], address: str) -> Iterator[Outcome]:
    try:
        distributed = importlib.import_module('distributed')
    except ImportError as error:
        raise RuntimeError(
            'a Dask cluster needs dask.distributed: pip install -r requirements-cluster.txt'
        ) from error
    with distributed.Client(address) as client:
        futures = client.map(work, tasks, [task.key for task in tasks], pure=False)
        try:
            for future in distributed.as_completed(futures):
                yield future.result()
        except BaseException:
            client.cancel(futures)
            raise
