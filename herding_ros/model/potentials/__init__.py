"""Potentials of two: one file each."""

from .morse import Morse
from .potential import Potential
from .power_law import PowerLaw
from .tabulated import Tabulated

__all__ = ['Morse', 'Potential', 'PowerLaw', 'Tabulated']
