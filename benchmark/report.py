# SPDX-License-Identifier: Apache-2.0
"""Writes the page and the picture: `python -m benchmark.report results.json --out doc`."""

from __future__ import annotations

import argparse
from pathlib import Path
from string import Template

from benchmark import tables
from benchmark.figure import draw
from benchmark.goals import growth, growth_of_step, milliseconds, NOT_MEASURED
from benchmark.results import Results
from herding_ros.model.fast_forces import CROSSOVER
from herding_ros.report.statistics import Quartiles

SECTION = 'written by scripts/benchmark'


def put(page: str, name: str, content: str) -> str:
    """Return the page with the section of this name written anew, or added at the end.

    A section lies between two comments, so that several programs can write on one page.
    """
    begin, end = f'<!-- {name}: begin -->\n', f'<!-- {name}: end -->\n'
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if bool(found) != bool(closed):
        raise ValueError(f'the page has one of {begin.strip()} and {end.strip()}, but not both')
    if not found and before:
        before = before.rstrip() + '\n\n'
    return f'{before}{begin}{content.strip()}\n{end}{after}'


def section(results: Results) -> str:
    """Return the text of the page."""

    def spread(values: list[float]) -> str:
        return str(Quartiles.of(values)) if values else NOT_MEASURED

    def largest_difference(what: str) -> str:
        found = [entry['difference'] for entry in results.of(what)]
        return f'{max(found):.0e}' if found else NOT_MEASURED

    roof = [
        1e-6 * entry['evaluations'] / seconds
        for entry in results.of('roofline with division')
        for seconds in entry['seconds']
    ]
    template = Template(Path(__file__).with_name('page.md').read_text(encoding='utf-8'))
    return template.substitute(
        goals=tables.goals(results),
        machine=tables.machine(results),
        difference=largest_difference('value and gradient'),
        gradients=tables.gradients(results),
        growth=spread(growth(results)),
        roof=spread(roof),
        division=spread(results.values('ratios', 'roofline with division')),
        roofline=tables.roofline(results),
        ensemble_difference=largest_difference('ensemble'),
        ensemble=tables.ensemble(results),
        optimiser=tables.optimiser(results),
        whole_solves=tables.whole_solves(results),
        feedback=tables.feedback(results),
        walls=tables.walls(results),
        filter=spread(milliseconds(results, 'command filter')),
        replan=tables.replan(results),
        herd=tables.herd(results),
        jitter=tables.jitter(results),
        forces=tables.forces(results),
        direct_forces=tables.direct_forces(results),
        crossover=tables.crossover(results),
        crossing=str(CROSSOVER),
        steps=tables.steps(results),
        step_growth=spread(growth_of_step(results)),
        memory=tables.memory(results),
    )


def write(results: Results, out: Path) -> Path:
    """Write performance.md and performance.png into a folder; return the page's path.

    What others wrote on the page stays.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / 'performance.md'
    page = path.read_text(encoding='utf-8') if path.exists() else ''
    path.write_text(put(page, SECTION, section(results)), encoding='utf-8')
    draw(results, out / 'performance.png')
    return path


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('results', type=Path, help='JSON of a run of the benchmark')
    parser.add_argument('--out', type=Path, default=Path('doc'), help='folder to write to (doc)')
    given = parser.parse_args()
    results = Results.read(given.results)
    path = write(results, given.out)
    print(f'\n{tables.goals(results)}\n\nwritten: {path}')


if __name__ == '__main__':
    main()
