# SPDX-License-Identifier: Apache-2.0
"""What is published on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

from herding_ros.control.receding_horizon import SolveReport

from .stamps import stamp_of


def diagnostics(
    name: str, ns: int, level: bytes, summary: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """One status of one part of a node, name 'node: part'."""
    status = DiagnosticStatus(level=level, name=name, message=summary, hardware_id='herding_ros')
    status.values = [KeyValue(key=key, value=_string(value)) for key, value in values.items()]
    return DiagnosticArray(header=Header(stamp=stamp_of(ns)), status=[status])


def _string(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def report_values(report: SolveReport) -> dict[str, object]:
    """Return what /diagnostics says about a solve."""
    return {
        'solve_ms': 1e3 * report.seconds['total'],
        'status': report.status.value,
        'objective': report.objective,
        'gradient_norm': report.gradient_norm,
        'optimiser_iterations': report.optimiser_iterations,
        'optimiser_calls': report.optimiser_calls,
        'fine_calls': report.fine_calls,
        'paths': ' '.join(str(n) for n in report.paths),
        'standard_error': report.standard_error,
        'extraction_calls': report.extraction_calls,
        'mapping_status': report.mapping_status.value,
        'mapping_iterations': report.mapping_iterations,
        'mapping_residuals': ' '.join(f'{r:.3g}' for r in report.mapping_residuals),
        'mapping_error_before': report.mapping_error_before,
        'mapping_error_after': report.mapping_error_after,
        **{f'{phase}_ms': 1e3 * s for phase, s in report.seconds.items() if phase != 'total'},
    }
