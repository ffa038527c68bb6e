"""The controller with a solver that is ill as long as a file says so.

Run as a program with the path of the file before the ROS arguments. With 'slow' in it, a solve
takes three times as long as its deadline allows; with 'broken', it fails.
"""

from pathlib import Path
import sys
import time

from herding_ros.control.receding_horizon import RecedingHorizon, Window
from herding_ros.control.solution import never, NoTimeFor
from herding_ros.model.state import HerdState
from herding_ros.nodes.controller import main

FILE = Path(sys.argv[1])
quick_solve = RecedingHorizon.solve


def is_(illness: str) -> bool:
    return FILE.exists() and FILE.read_text() == illness


def ailing_solve(
    self: RecedingHorizon, state: HerdState, t: float, no_time_for: NoTimeFor = never
) -> Window:
    if is_('broken'):
        raise ArithmeticError('the solver is broken')
    begun = time.monotonic()
    window = quick_solve(self, state, t, no_time_for)
    while is_('slow') and not no_time_for('sleep'):
        time.sleep(0.01)
    granted = time.monotonic() - begun
    while is_('slow') and time.monotonic() < begun + 3.0 * granted:
        time.sleep(0.01)
    return window


if __name__ == '__main__':
    RecedingHorizon.solve = ailing_solve  # type: ignore[method-assign]
    sys.exit(main(sys.argv[2:]))
