"""The pages: templates, filled with what the studies found."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from string import Template

from . import markdown
from .study import Section

_TITLES = {
    'stochasticity': 'Influence of the noise (Table 1, Figure "compare iterations")',
    'dogs': 'Influence of the number of dogs (Figure "trajectories")',
    'stabilisation': 'Stabilisation (Figure "simulation")',
    'symmetry': 'Symmetric herds (section 6.3)',
    'baselines': 'Against simpler controllers',
    'observation': 'Noisy observations',
    'evacuation': 'Evacuation: guides in place of dogs',
    'common_noise': 'Noise that all sheep have in common (remark in section 2.1)',
    'mean_field': 'Large flocks: the mean-field limit as coarse model (section 7)',
    'sampling': 'Cost of an expectation',
}

OF_THEIR_OWN = ('observation', 'evacuation', 'common_noise', 'mean_field', 'sampling')
"""Studies of what the paper does not show, each with a page of its own."""


def page(sections: Mapping[str, Section]) -> str:
    """Return the page about the paper's results, which leads to those about the others."""
    further = [name for name in sections if name in OF_THEIR_OWN]
    sections = {name: each for name, each in sections.items() if name not in OF_THEIR_OWN}
    return (
        _fill(
            'reproduction',
            {
                'overview': markdown.overview(
                    (name, row) for name, section in sections.items() for row in section.rows
                ),
                'goals': markdown.goals(
                    goal for section in sections.values() for goal in section.goals
                ),
                'sections': '\n\n'.join(
                    f'## {_TITLES[name]}\n\n{_fill(name, section.values)}'
                    for name, section in sections.items()
                ),
                'further': '\n'.join(f'- [{_TITLES[name]}]({name}.md)' for name in further),
            },
        )
        + '\n'
    )


def single(name: str, section: Section) -> str:
    """Return the page about one study."""
    parts = [f'# {_TITLES[name]}', markdown.overview((name, row) for row in section.rows)]
    if section.goals:
        parts.append(markdown.goals(section.goals))
    return '\n\n'.join([*parts, _fill(name, section.values)]) + '\n'


def _fill(name: str, values: Mapping[str, str]) -> str:
    """Return a template with its placeholders filled; every one needs a value."""
    path = Path(__file__).with_name('pages') / f'{name}.md'
    return Template(path.read_text(encoding='utf-8')).substitute(values).strip()
