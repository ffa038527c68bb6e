# SPDX-License-Identifier: Apache-2.0
"""Results on disk, one JSON file for each task."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
import tempfile
from typing import Any

from herding_ros import __version__

from .task import code, Task

Result = dict[str, Any]

_log = logging.getLogger(__name__)


class Store:
    """A folder of results. Writing is atomic: a result is stored completely or not at all."""

    def __init__(self, folder: Path) -> None:
        """Store results in this folder, which is made for the first one."""
        self.folder = folder

    def path(self, task: Task) -> Path:
        """Return the path of the result of a task."""
        return self.folder / task.kind / f'{task.key}.json'

    def load(self, task: Task) -> Result | None:
        """Return the result of a task; None if there is none or it is damaged."""
        path = self.path(task)
        try:
            entry = json.loads(path.read_text(encoding='utf-8'))
            if entry['kind'] != task.kind or entry['parameters'] != task.parameters:
                raise ValueError('it is the result of another task')
            result = entry['result']
            if not isinstance(result, dict):
                raise ValueError(f'its result is a {type(result).__name__}')
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError) as error:
            _log.warning('%s is damaged and will be recomputed: %r', path, error)
            return None
        return result

    def keep(self, task: Task, result: Result, seconds: float) -> None:
        """Write the result of a task, with everything that is needed to reproduce it.

        Raises ValueError when the result holds NaN or infinity, which JSON cannot represent.
        """
        entry = {
            'kind': task.kind,
            'parameters': task.parameters,
            'version': __version__,
            'code': code(),
            'seconds': round(seconds, 3),
            'result': result,
        }
        text = json.dumps(entry, allow_nan=False, separators=(',', ':'))
        path = self.path(task)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix='.tmp')
        try:
            with os.fdopen(handle, 'w', encoding='utf-8') as file:
                file.write(text + '\n')
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)  # a signal may have come after it was moved
            raise
