# SPDX-License-Identifier: Apache-2.0
"""How dogs move under their commands: one file for each motion model."""

from .accelerating import Accelerating
from .holonomic import Holonomic
from .motion_model import check_states, MotionModel, Obedient, returned
from .unicycle import steered_ahead, Unicycle

MOTIONS: dict[str, Obedient] = {
    'holonomic': Holonomic(),
    'accelerating': Accelerating(),
    'unicycle': Unicycle(),
}
"""Motions by the name that the parameter `motion.kind` takes."""

__all__ = [
    'MOTIONS',
    'Accelerating',
    'Holonomic',
    'MotionModel',
    'Obedient',
    'Unicycle',
    'check_states',
    'returned',
    'steered_ahead',
]
