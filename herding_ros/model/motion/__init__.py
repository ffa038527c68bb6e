# SPDX-License-Identifier: Apache-2.0
"""How dogs move under their commands: one file for each motion model."""

from .holonomic import Holonomic
from .motion_model import MotionModel

__all__ = ['Holonomic', 'MotionModel']
