# SPDX-License-Identifier: Apache-2.0
"""What a force on the sheep from the world is, such as a fence's; by default there is none.

Apart from external_force.py, which makes a new one, so that parameters need no compiled code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .parameters import Parameters


class Form(NamedTuple):
    """An external force in compiled code: which it is, and its numbers and arrays.

    The name of the only field of kind's dtype says which: so it is part of the form's type.
    """

    kind: NDArray[np.void]
    values: tuple[Any, ...]


ExternalForm = Form | tuple[()]
"""(): no force."""


@runtime_checkable
class ExternalForce(Protocol):
    """A force f(x) on each sheep [m/s^2] that depends on its place x alone."""

    def kernel_form(self) -> ExternalForm:
        """Return what the kernels need: the result of what `register` has returned."""


@dataclass(frozen=True)
class NoForce(Parameters):
    """Nothing but sheep and dogs."""

    def kernel_form(self) -> tuple[()]:
        """Return the empty form."""
        return ()
