# SPDX-License-Identifier: Apache-2.0
"""The code on the pages of doc/."""

from __future__ import annotations

from pathlib import Path
import re

DOC = Path(__file__).resolve().parents[2] / 'doc'


def blocks(page: str, language: str = '') -> list[str]:
    """Return the blocks of code of a page in a language, '' being the shell."""
    text = (DOC / page).read_text(encoding='utf-8')
    found = re.findall(r'^```(\w*)\n(.*?)^```$', text, re.S | re.M)
    return [code for kind, code in found if kind == language]
