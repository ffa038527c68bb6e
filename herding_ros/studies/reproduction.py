# SPDX-License-Identifier: Apache-2.0
"""All studies, and the pages about them: templates filled with the findings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from string import Template

from herding_ros.report import markdown

from . import (
    baselines,
    common_noise,
    controller,
    dogs,
    evacuation,
    fields,
    mean_field,
    observation,
    real,
    sampling,
    stabilisation,
    stochasticity,
    strangers,
    symmetry,
)
from .study import Row, Section, Study

OF_THE_PAPER: dict[str, Study] = {
    'stochasticity': stochasticity,
    'dogs': dogs,
    'stabilisation': stabilisation,
    'symmetry': symmetry,
    'baselines': baselines,
}
"""Studies that are sections of the page about the paper."""

FURTHER: dict[str, Study] = {
    'controller': controller,
    'observation': observation,
    'evacuation': evacuation,
    'fields': fields,
    'common_noise': common_noise,
    'mean_field': mean_field,
    'sampling': sampling,
    'strangers': strangers,
    'real': real,
}
"""Studies of what the paper does not show, each with its own page."""

STUDIES = OF_THE_PAPER | FURTHER


def page(sections: Mapping[str, Section]) -> str:
    """Return the page about the paper's results, which links to those of the further studies."""
    found = {name: sections[name] for name in OF_THE_PAPER}
    values = {
        'overview': _overview((name, row) for name, each in found.items() for row in each.rows),
        'goals': markdown.goals(goal for each in found.values() for goal in each.goals),
        'sections': '\n\n'.join(
            f'## {OF_THE_PAPER[name].TITLE}\n\n{_fill(name, section.values)}'
            for name, section in found.items()
        ),
        'further': '\n'.join(f'- [{each.TITLE}]({name}.md)' for name, each in FURTHER.items()),
    }
    return _fill('reproduction', values) + '\n'


def single(name: str, section: Section) -> str:
    """Return the page about one study."""
    parts = [f'# {STUDIES[name].TITLE}']
    if section.rows:
        parts.append(_overview((name, row) for row in section.rows))
    if section.goals:
        parts.append(markdown.goals(section.goals))
    return '\n\n'.join([*parts, _fill(name, section.values)]) + '\n'


def _overview(rows: Iterable[tuple[str, Row]]) -> str:
    """Return the table of all figures and tables, each with the study that it is from."""
    return markdown.table(
        {
            'figure or table': row.what,
            'command': f'`study {name}`',
            'paper': row.paper,
            'ours': row.ours,
            'remark': row.remark,
        }
        for name, row in rows
    )


def _fill(name: str, values: Mapping[str, str]) -> str:
    """Return a template with its placeholders filled; every placeholder needs a value."""
    path = Path(__file__).with_name('pages') / f'{name}.md'
    return Template(path.read_text(encoding='utf-8')).substitute(values).strip()
