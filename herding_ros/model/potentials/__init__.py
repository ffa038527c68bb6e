# SPDX-License-Identifier: Apache-2.0
"""Potentials of two: one file each."""

from .harmonic import Harmonic
from .mollified import Mollified
from .morse import Morse
from .potential import Potential
from .power_law import PowerLaw
from .tabulated import Tabulated

__all__ = ['Harmonic', 'Mollified', 'Morse', 'Potential', 'PowerLaw', 'Tabulated']
