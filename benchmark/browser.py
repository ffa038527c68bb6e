# SPDX-License-Identifier: Apache-2.0
"""A browser without a window, for tests of pages and for what their speed is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import shutil
from typing import Any

import pytest


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield a WebDriver of Debian's Chromium, which reaches nothing but this machine.

    It draws by the processor. Skips the test where Chromium or selenium is missing.
    """
    webdriver = pytest.importorskip(
        'selenium.webdriver', reason='needs selenium: pip install -r requirements-browser.lock'
    )
    program, driver = shutil.which('chromium'), shutil.which('chromedriver')
    if program is None or driver is None:
        pytest.skip('needs Chromium: apt-get install chromium chromium-driver')
    options = webdriver.ChromeOptions()
    options.binary_location = program
    options.page_load_strategy = 'none'
    for argument in (
        'headless=new', 'no-sandbox', 'disable-dev-shm-usage', 'window-size=1200,800',
        'use-angle=swiftshader', 'enable-unsafe-swiftshader',
        'host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1',
        'disable-features=BackForwardCache',  # it keeps a page that was left, with its connection
    ):  # fmt: skip
        options.add_argument(f'--{argument}')
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL'})
    one = webdriver.Chrome(options, webdriver.ChromeService(driver))
    try:
        yield one
    finally:
        one.quit()
