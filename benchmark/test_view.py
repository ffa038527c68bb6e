# SPDX-License-Identifier: Apache-2.0
"""The page of the view in a browser without a graphics card."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time
from typing import Any

from benchmark.browser import chromium
from herding_ros.model.field import Field
from herding_ros.view.frame import Frame, MOST_TRAIL
from herding_ros.view.page import Page
from herding_ros.view.playback import PERIOD
import numpy as np
import pytest

SECONDS = 6.0
DOGS = 5

COUNT = """
window.pictures = 0;
(function count() { requestAnimationFrame(() => { window.pictures++; count(); }); })();
const draw = WebGL2RenderingContext.prototype.drawElementsInstanced;
WebGL2RenderingContext.prototype.drawElementsInstanced = function (...given) {
  window.first = window.first ?? performance.now();
  return draw.apply(this, given);
};
"""
"""Counts pictures, and notes when the first has something of a herd in it [ms]."""


def frames(herded: int) -> Iterator[Frame]:
    """Yield a herd on its way, with trails and plans."""
    rng = np.random.default_rng(0)
    x, d = rng.normal(0.0, 0.2, (herded, 2)), rng.normal(-0.5, 0.2, (DOGS, 2))
    back = np.linspace([-0.5, 0.0], [0.0, 0.0], MOST_TRAIL)[:, None]
    ahead = np.linspace([0.0, 0.0], [1.0, 0.2], 200)[:, None]
    for k in range(10_000):
        gone = np.array([1e-3 * k, 0.0])
        yield Frame(
            time=0.1 * k, x=x + gone, d=d + gone, headings=np.full(DOGS, 1e-2 * k),
            numbers=tuple(range(1, DOGS + 1)), goal=np.array([2.0, 0.0]),
            plans=d + gone + ahead, expected=gone + ahead[:, 0], dog_trails=d + gone + back,
            centre_trail=gone + back[:, 0], field=Field(),
        )  # fmt: skip


@pytest.fixture
def browser() -> Iterator[Any]:
    """Return a browser that has shown nothing yet."""
    with chromium() as one:
        one.execute_cdp_cmd('Page.addScriptToEvaluateOnNewDocument', {'source': COUNT})
        yield one


@pytest.mark.parametrize('herded', [30, 10_000])
def test_page(
    benchmark: Any, record: Callable[..., None], browser: Any, quick: bool, herded: int
) -> None:
    """Load it, then let the herd move as often as the view shows it."""
    if quick:
        pytest.skip('--quick')
    page, herd = Page('127.0.0.1', 8100, 'herd', ()), frames(herded)
    page.show(next(herd))

    def load() -> float:
        browser.get(page.url)
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            if first := browser.execute_script('return window.first'):
                return 1e-3 * float(first)
            time.sleep(0.05)
        raise TimeoutError(f'nothing to be seen at {page.url} within 60 s')

    try:
        until_seen = benchmark.pedantic(load, rounds=1)
        time.sleep(2.0)
        before, begun = browser.execute_script('return window.pictures'), time.monotonic()
        cpu = time.process_time()
        while time.monotonic() < begun + SECONDS:
            page.show(next(herd))
            time.sleep(PERIOD)
        cpu, passed = time.process_time() - cpu, time.monotonic() - begun
        drawn = browser.execute_script('return window.pictures') - before
    finally:
        page.close()
    rate = drawn / passed
    record(
        'view',
        f'{until_seen:.1f} s until it is seen, then {rate:.1f} pictures a second',
        herded=herded,
        until_seen=[until_seen],
        rates=[rate],
        load=cpu / passed,
    )
