# SPDX-License-Identifier: Apache-2.0
"""A recorded run, played in the browser."""

from __future__ import annotations

from herding_ros.bag.recorded_run import in_play, RecordedRun
from herding_ros.model.field import Field
from herding_ros.model.flock import centre
from herding_ros.report.curves import curves
from herding_ros.report.summary import field
import numpy as np
import viser

from .frame import Curve, Frame, MOST_TRAIL, TRAIL
from .page import Page

PERIOD = 0.05
"""Time between two pictures [s]."""

_CONTROLS = ('play', 'stop', 'from the start')


def frame_at(run: RecordedRun, k: int, field: Field) -> Frame:
    """Return what there is to be seen in state k of a run in a field."""
    now = float(run.times[k])
    first = int(np.searchsorted(run.times, now - TRAIL))
    past = range(first, k + 1, max((k - first) // MOST_TRAIL, 1))
    plan, expected = in_play(run.plans, now), in_play(run.expected, now)
    return Frame(
        time=now,
        x=run.x[k][run.seen[k]],
        d=run.d[k],
        headings=run.headings[k],
        numbers=run.dogs,
        goal=run.goal_at(now),
        plans=np.zeros((0, 0, 2)) if plan is None else plan.ahead(now),
        expected=np.zeros((0, 2)) if expected is None else expected.ahead(now),
        dog_trails=run.d[past],
        centre_trail=np.array([centre(run.x[j][run.seen[j]]) for j in past]),
        field=field,
        surroundings=run.surroundings_at(now),
    )


def curves_of(run: RecordedRun) -> tuple[Curve, ...]:
    """Return what is known of a run over time."""
    return tuple(
        Curve(each.label, each.times.tolist(), each.values.tolist()) for each in curves(run)
    )


class Playback:
    """Plays a run on a page; `advance` is to be called every `PERIOD`."""

    def __init__(self, run: RecordedRun, host: str, port: int, title: str) -> None:
        """Serve the page; raises what `Page` raises."""
        self._run = run
        self._field = field(run)[0]
        self.page = page = Page(host, port, title, curves_of(run))
        self._write = page.add_text()
        self._plays = True
        self._shown = -1, 0
        end = float(run.times[-1])
        self._time = page.gui.add_slider('time [s]', 0.0, max(end, PERIOD), 0.1, 0.0)
        self._speed = page.gui.add_slider(
            'speed', 0.1, 20.0, 0.1, 5.0, hint='multiple of real time'
        )
        buttons = page.gui.add_button_group('', _CONTROLS)

        @buttons.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle[str]]) -> None:
            self._plays = event.target.value != 'stop'
            if event.target.value == 'from the start':
                self._time.value = 0.0

        page.add_camera_button()
        page.add_curves()

    def advance(self) -> None:
        """Show the run as it is a moment later, if it plays, or where the slider was moved to."""
        end = float(self._run.times[-1])
        if self._plays and self.page.browsers:
            self._time.value = min(self._time.value + PERIOD * self._speed.value, end)
            self._plays = self._time.value < end
        k = int(np.searchsorted(self._run.times, self._time.value, side='right')) - 1
        shown = k, self.page.browsers
        if shown == self._shown:
            return
        self._shown = shown
        self.page.show(frame_at(self._run, k, self._field))
        self._write(f't {self._run.times[k]:.1f} of {end:.1f} s')
