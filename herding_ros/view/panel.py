# SPDX-License-Identifier: Apache-2.0
"""The panel beside a live herd: time, curves, and the parameters that may change meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import groupby

from herding_ros.model.state import Array
import viser

from .page import Page

_FIRST, _FIRST_NAMES = 'live', ('real_time_factor', 'crowd.noise', 'max_speed')
"""Parameters that most people come for, and their folder; the others are in closed ones."""

_STEPS = 200
"""Steps of a slider."""


@dataclass(frozen=True)
class Tunable:
    """A parameter that may change: its value, unit and meaning, and the ends of its slider."""

    value: float
    unit: str
    doc: str
    lowest: float
    highest: float


@dataclass(frozen=True)
class Wishes:
    """What to do when somebody uses the page; called in threads of the page."""

    move_goal: Callable[[Array], None]
    pause: Callable[[bool], None]
    reset: Callable[[], None]
    set_value: Callable[[str, float], None]


class LivePanel:
    """The panel: it shows what is in force, not what was asked for."""

    def __init__(self, page: Page, wishes: Wishes) -> None:
        """Add what is always there; time and parameters come when their nodes are there."""
        self._page = page
        self._wishes = wishes
        self._sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        self.write = page.add_text()
        """Says how it goes."""
        self._complain = page.add_text()
        buttons = page.gui.add_button_group('time', ('pause', 'go on', 'reset'), visible=False)
        self._buttons = buttons

        @buttons.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle[str]]) -> None:
            if event.target.value == 'reset':
                wishes.reset()
            else:
                wishes.pause(event.target.value == 'pause')

        page.add_camera_button()
        tabs = page.gui.add_tab_group()
        with tabs.add_tab('curves'):
            page.add_curves()
        self._tab = tabs.add_tab('parameters')
        page.on_click(wishes.move_goal)

    def show_time_control(self, is_there: bool) -> None:
        """Show the buttons, if there is a sim to press them for."""
        if self._buttons.visible != is_there:
            self._buttons.visible = is_there

    def refuse(self, reason: str) -> None:
        """Say why something did not happen, until something does."""
        self._complain(f'**{reason}**')
        self._page.warn(reason)

    def accept(self) -> None:
        """Say that something happened."""
        self._complain('')

    def offer(self, tunables: Mapping[str, Tunable]) -> None:
        """Add sliders for the parameters that have none."""
        new = {name: each for name, each in tunables.items() if name not in self._sliders}
        for group, members in groupby(sorted(new, key=_order), _group):
            with self._tab, self._page.gui.add_folder(group, expand_by_default=group == _FIRST):
                for name in members:
                    self._sliders[name] = self._slider(name, new[name])

    def _slider(self, name: str, tunable: Tunable) -> viser.GuiSliderHandle[float]:
        slider = self._page.gui.add_slider(
            f'{name} [{tunable.unit}]' if tunable.unit else name,
            tunable.lowest,
            tunable.highest,
            (tunable.highest - tunable.lowest) / _STEPS,
            tunable.value,
            hint=tunable.doc,
        )

        @slider.on_update
        def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if event.client is not None:  # somebody moved it, not `show_value`
                self._wishes.set_value(name, float(event.target.value))

        return slider

    def show_value(self, name: str, value: float) -> None:
        """Show the value of a parameter that is in force; nothing where it has no slider."""
        if slider := self._sliders.get(name):
            slider.max = max(slider.max, value)
            slider.value = value


def _group(name: str) -> str:
    return _FIRST if name in _FIRST_NAMES else name.rpartition('.')[0] or 'others'


def _order(name: str) -> tuple[bool, str, str]:
    return _group(name) != _FIRST, _group(name), name
