# SPDX-License-Identifier: Apache-2.0
"""How a plan was found, and how long it took."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
import time
from typing import ParamSpec, TYPE_CHECKING, TypeVar

from .solution import Solution, Status

if TYPE_CHECKING:
    from herding_ros.model.expectation import Expectation

    from .dog_force import Felt
    from .space_mapping import MappingResult

_P = ParamSpec('_P')
_T = TypeVar('_T')


@dataclass(frozen=True)
class SolveReport:
    """How a plan was found; `values` has the names under which all of it is published."""

    kind: str
    """'window', with its space mapping, or 'feedback', an improvement between two of them."""
    status: Status
    """Of the coarse solve; a solve that did not converge is a status, not an error."""
    objective: float
    gradient_norm: float
    optimiser_iterations: int
    optimiser_calls: int
    """Evaluations of value and gradient in the coarse solve, on both time grids."""
    fine_calls: int
    """Monte Carlo evaluations of the fine model, each of all paths."""
    paths: tuple[int, ...]
    """Paths of an evaluation, by level, the finest last; empty without mapping."""
    standard_error: float
    """The largest of these evaluations' [m]; 0 without mapping."""
    extraction_calls: int
    """Rollouts of the coarse model in parameter extraction."""
    mapping_status: Status
    mapping_iterations: int
    mapping_residuals: tuple[float, ...]
    """|T(u_f) - u_c| / |u_c| of each iterate; empty without aggressive mapping."""
    mapping_error_before: float
    """|X - x_c| in L2(0, T) [m s^0.5] under the coarse plan; 0 without mapping."""
    mapping_error_after: float
    """The same under the plan that was chosen."""
    felt_strength: float
    """How strongly the plan takes dogs to be felt, as a multiple of what the crowd says."""
    felt_range: float
    """How far, as a multiple."""
    seconds: dict[str, float]
    """Time per phase: coarse (solve), fine (Monte Carlo), extraction; and in total."""

    @classmethod
    def of(
        cls,
        kind: str,
        solution: Solution,
        mapping: MappingResult,
        expected: Sequence[Expectation],
        extraction_calls: int,
        felt: Felt,
        seconds: dict[str, float],
    ) -> SolveReport:
        """Return the report of a coarse solution, its correction, and the fine evaluations."""
        return cls(
            kind=kind,
            status=solution.status,
            objective=solution.value,
            gradient_norm=solution.gradient_norm,
            optimiser_iterations=solution.iterations,
            optimiser_calls=solution.calls,
            fine_calls=len(expected),
            paths=expected[0].paths if expected else (),
            standard_error=max((each.standard_error for each in expected), default=0.0),
            extraction_calls=extraction_calls,
            mapping_status=mapping.status,
            mapping_iterations=mapping.iterations,
            mapping_residuals=mapping.residuals,
            mapping_error_before=mapping.misfits[0] if mapping.misfits else 0.0,
            mapping_error_after=min(mapping.misfits, default=0.0),
            felt_strength=felt.strength,
            felt_range=felt.range,
            seconds=seconds,
        )

    def values(self) -> dict[str, float | str]:
        """Return everything as numbers and strings by name, as in /diagnostics and bags.

        Times are in ms: solve_ms in total, and <phase>_ms.
        """
        milliseconds = {f'{phase}_ms': 1e3 * s for phase, s in self.seconds.items()}
        found: dict[str, float | str] = {'solve_ms': milliseconds.pop('total_ms')}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Status):
                found[field.name] = value.value
            elif isinstance(value, tuple):
                found[field.name] = ' '.join(
                    str(n) if isinstance(n, int) else f'{n:.3g}' for n in value
                )
            elif not isinstance(value, dict):
                found[field.name] = value
        return {**found, **milliseconds}


class Stopwatch:
    """Seconds spent in each phase of a solve."""

    def __init__(self) -> None:
        """Start."""
        self._seconds = {'coarse': 0.0, 'fine': 0.0, 'extraction': 0.0}
        self._started = time.perf_counter()

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time spent within to a phase."""
        started = time.perf_counter()
        yield
        self._seconds[name] += time.perf_counter() - started

    def timing(self, name: str, function: Callable[_P, _T]) -> Callable[_P, _T]:
        """Return the same function, whose calls are a phase."""

        def timed(*args: _P.args, **options: _P.kwargs) -> _T:
            with self.phase(name):
                return function(*args, **options)

        return timed

    def seconds(self) -> dict[str, float]:
        """Return the seconds by phase, and in total."""
        return {**self._seconds, 'total': time.perf_counter() - self._started}
