# SPDX-License-Identifier: Apache-2.0
"""What is published on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

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
