# SPDX-License-Identifier: Apache-2.0
"""Herd twenty sheep with three dogs, and draw their paths: herd_and_plot.py [PICTURE]."""

import sys

from herding_ros import closed_loop, Control, Crowd, distance, spread, World
from matplotlib.figure import Figure

goal = [0.5, 0.5]
run = closed_loop(Crowd(), World(sheep=20, dogs=3, seed=1), Control(), goal, time_limit=200.0)

print(f'arrived: {run.arrived}, after {run.t[-1]:.1f} s in {len(run.reports)} plans')
print(f'distance {distance(run.x[-1], goal):.3f} m, spread {spread(run.x[-1]):.3f} m')

figure = Figure(figsize=(5, 5), layout='constrained')
axes = figure.subplots()
axes.plot(*run.x.transpose(2, 0, 1), color='tab:blue', linewidth=0.5)
axes.plot(*run.d.transpose(2, 0, 1), color='tab:red')
axes.plot(*goal, 'kx')
axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else 'herd.png')
