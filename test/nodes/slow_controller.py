"""The controller, its solver three times as slow as its deadline allows.

Run as a program with the path of a file before the ROS arguments; without the file the solver is
as fast as ever.
"""

from pathlib import Path
import sys
import time

from herding_ros.control.receding_horizon import RecedingHorizon, Window
from herding_ros.control.solution import never, OutOfTime
from herding_ros.model.state import HerdState
from herding_ros.nodes.controller import main

FLAG = Path(sys.argv[1])
quick_solve = RecedingHorizon.solve


def slow_solve(
    self: RecedingHorizon, state: HerdState, t: float, out_of_time: OutOfTime = never
) -> Window:
    begun = time.monotonic()
    window = quick_solve(self, state, t, out_of_time)
    while FLAG.exists() and not out_of_time():
        time.sleep(0.01)
    granted = time.monotonic() - begun
    while FLAG.exists() and time.monotonic() < begun + 3.0 * granted:
        time.sleep(0.01)
    return window


if __name__ == '__main__':
    RecedingHorizon.solve = slow_solve  # type: ignore[method-assign]
    sys.exit(main(sys.argv[2:]))
