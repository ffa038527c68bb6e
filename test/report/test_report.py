# SPDX-License-Identifier: Apache-2.0
"""The picture, the summary and the program that makes them of a bag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from io import StringIO
import json
from pathlib import Path
from typing import Any

from herding_ros.bag.recorded_run import RecordedRun, Replan, Topic
from herding_ros.model.bodies import closest
from herding_ros.report import figures
from herding_ros.report.cli import main, write_report
from herding_ros.report.figures import save_trajectories
from herding_ros.report.summary import summarise
from matplotlib.figure import Figure
from matplotlib.image import imread
import numpy as np
import pytest
from rich.console import Console

NAN = float('nan')


def replan(number: int, solve_ms: float, kind: str = 'window') -> Replan:
    return Replan(
        10.0 * number, number, 'converged', solve_ms, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, kind
    )


def square(centre: tuple[float, float], spread: float) -> Any:
    """Four sheep whose centre and spread are known."""
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / np.sqrt(2)
    return np.array(centre) + spread * corners


@pytest.fixture
def run() -> RecordedRun:
    """Four sheep on their way to (1, 0): 0.5 m short, scattered at the goal, home, past it."""
    x = np.stack(
        [square((0, 0), 0.4), square((0.5, 0), 0.4), square((1, 0), 0.7), square((0.96, 0), 0.55),
         square((1.2, 0), 0.4)]
    )  # fmt: skip
    times = 0.5 * np.arange(5)
    d = np.stack([x[:, 0] - 1, x[:, 1] - 1], axis=1)
    return RecordedRun(
        times=times,
        x=x,
        v=np.zeros_like(x),
        d=d,
        dogs=(1, 2),
        command_times=times,
        commands=np.zeros_like(d),
        goal=np.array([1.0, 0.0]),
        replans=(replan(0, 30.0), replan(1, 10.0), replan(2, 11.0)),
        replans_made=3,
        namespace='',
        parameters={'/sim': {'seed': 7}},
        version='1.2.3',
        wall_s=0.25,
        topics=(Topic('/a', 'a_msgs/msg/A', 3, 1.0), Topic('/b', 'a_msgs/msg/B', 4, 2.0)),
        notes=(),
    )


@pytest.mark.parametrize(('sheep', 'cells'), [(1000, []), (1001, [1001, 1001])])
def test_many_sheep_are_drawn_as_a_density(run: RecordedRun, sheep: int, cells: list[int]) -> None:
    x = np.random.default_rng(0).normal(0.0, 0.3, (5, sheep, 2))
    axes = Figure().add_subplot()
    figures._draw_map(axes, replace(run, x=x))
    assert [each.get_array().sum() for each in axes.collections] == cells  # everyone counts
    dots = [line for line in axes.lines if line.get_marker() == 'o']
    assert [len(line.get_xdata()) for line in dots] == ([] if cells else [sheep, sheep])
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert f'{sheep} sheep, start' in words


def test_summary_of_an_arrival(run: RecordedRun) -> None:
    summary = summarise(run)
    assert summary['arrived'] is True
    assert summary['time_s'] == 1.5  # at 1.0 the centre is there, but the flock is scattered
    assert summary['final_distance_m'] == pytest.approx(0.2)
    assert summary['max_spread_m'] == pytest.approx(0.7)
    assert summary['initial_spread_m'] == pytest.approx(0.4)
    assert summary['replans'] == 3
    assert summary['largest_gap_s'] == 0.5
    assert summary['notes'] == []
    assert summary['solve_ms_median'] == 11.0
    assert summary['solve_ms_max'] == 30.0
    assert summary['messages_recorded'] == 7
    assert summary['messages_lost'] is None
    assert summary['wall_s'] == 0.25
    assert summary['real_time_factor'] == 8.0
    assert summary['seed'] == 7
    assert (summary['sheep'], summary['dogs']) == (4, 2)
    assert summary['closest_dogs_m'] == closest(run.d)
    assert summary['touches'] == 0
    assert summary['goal'] == [1.0, 0.0]
    assert summary['version'] == '1.2.3'


def test_summary_tells_feedbacks_from_windows(run: RecordedRun) -> None:
    replans = (*run.replans, replan(3, 1.0, 'feedback'), replan(4, 2.5, 'feedback'))
    found, without = summarise(replace(run, replans=replans, replans_made=5)), summarise(run)
    assert (found['replans'], found['feedbacks']) == (5, 2)
    assert (found['solve_ms_median'], found['solve_ms_max']) == (11.0, 30.0)
    assert found['feedback_ms_median'] == 1.75
    assert (without['feedbacks'], without['feedback_ms_median']) == (0, None)


def with_arrival(run: RecordedRun, **values: Any) -> RecordedRun:
    """The run in a bag with such parameters of the sim."""
    named = {f'arrival.{name}': value for name, value in values.items()}
    return replace(run, parameters={'/sim': {'seed': 7, **named}})


def test_arrival_is_judged_by_the_parameters_that_were_recorded(run: RecordedRun) -> None:
    wide = summarise(with_arrival(run, spread=2.0))
    assert (wide['arrived'], wide['time_s']) == (True, 1.0)
    assert summarise(with_arrival(run, spread=2.0, radius=0.6))['time_s'] == 0.5
    assert summarise(with_arrival(run, radius=0.01))['arrived'] is False
    given = {'radius': 0.6, 'spread': 1.5, 'strays': 0}
    summary = summarise(with_arrival(run, radius=0.6))
    assert {name: summary[f'arrival.{name}'] for name in given} == given


def test_strays_that_may_be_left_behind_do_not_count(run: RecordedRun) -> None:
    stray = np.stack([[-5.0, 0.1 * k] for k in range(5)])[:, None]
    more = replace(run, x=np.concatenate([stray, run.x], axis=1), v=np.zeros((5, 5, 2)))
    left, usual, same = summarise(with_arrival(more, strays=1)), summarise(run), summarise(more)
    for each in ('arrived', 'time_s', 'final_distance_m', 'max_spread_m', 'initial_spread_m'):
        assert left[each] == pytest.approx(usual[each])
        assert left[each] != pytest.approx(same[each])
    assert left['sheep'] == 5
    x = more.x.copy()
    x[-1, 0] = NAN  # the stray is out of sight, and the farthest of the others does not count
    unseen = summarise(with_arrival(replace(more, x=x), strays=1))
    assert unseen['final_distance_m'] != pytest.approx(usual['final_distance_m'])


def test_bad_arrival_parameters_of_a_bag_are_noted(run: RecordedRun) -> None:
    summary = summarise(with_arrival(run, radius='wide', strays=1))
    assert (summary['time_s'], summary['arrival.strays']) == (1.5, 0)
    (note,) = summary['notes']
    assert note == (
        'the arrival is judged by the default parameters: Arrival.radius must be a number from '
        "1e-09 to 1e+09, got 'wide'"
    )
    long = summarise(with_arrival(run, radius='w' * 10_000))
    assert len(long['notes'][0]) <= 500


def test_summary_without_arrival(run: RecordedRun) -> None:
    summary = summarise(replace(run, goal=np.array([5.0, 5.0])))
    assert summary['arrived'] is False
    assert summary['time_s'] == 2.0


def test_sheep_that_are_not_seen_do_not_count(run: RecordedRun) -> None:
    """The last sheep is out of sight at first and at the end: the others decide."""
    x = run.x.copy()
    x[[0, -1], 3] = NAN
    summary = summarise(replace(run, x=x))
    assert summary['sheep'] == 4
    assert summary['initial_spread_m'] == pytest.approx(0.4)  # that of the first whole flock
    assert summary['time_s'] == 1.5
    centre = x[-1, :3].mean(axis=0)
    assert summary['final_distance_m'] == pytest.approx(np.hypot(*(centre - run.goal)))


def test_summary_without_destination(run: RecordedRun) -> None:
    summary = json.loads(json.dumps(summarise(replace(run, goal=None)), allow_nan=False))
    assert [summary[key] for key in ('arrived', 'final_distance_m', 'goal')] == [None] * 3
    assert summary['time_s'] == 2.0


def test_summary_of_what_is_unknown_is_valid_json(run: RecordedRun) -> None:
    bare = replace(run, replans=(replan(0, NAN),), parameters={}, wall_s=0.0)
    summary = json.loads(json.dumps(summarise(bare), allow_nan=False))
    for key in ('solve_ms_median', 'solve_ms_max', 'seed', 'real_time_factor'):
        assert summary[key] is None


def is_coloured(picture: Any, kind: Callable[[Any, Any, Any], Any]) -> int:
    red, green, blue = (picture[..., k] for k in range(3))
    return int(np.count_nonzero(kind(red, green, blue)))


def test_picture_shows_sheep_dogs_and_goal(run: RecordedRun, tmp_path: Path) -> None:
    save_trajectories(run, tmp_path / 'trajectories.png')
    picture = imread(tmp_path / 'trajectories.png')
    height, width = picture.shape[:2]
    assert height > 800
    assert width > 1500
    for kind in (
        lambda r, g, b: (b > 0.5) & (r < 0.3),
        lambda r, g, b: (r > 0.6) & (b < 0.3),
        lambda r, g, b: (r < 0.1) & (g < 0.1) & (b < 0.1),
    ):
        assert is_coloured(picture[:, : width // 2], kind) > 100


def test_picture_as_pdf_is_one(run: RecordedRun, tmp_path: Path) -> None:
    save_trajectories(run, tmp_path / 'trajectories.pdf')
    found = (tmp_path / 'trajectories.pdf').read_bytes()
    assert found.startswith(b'%PDF-')
    assert found.rstrip().endswith(b'%%EOF')


@pytest.mark.parametrize(
    'change',
    [
        {'replans': ()},
        {'replans': (replan(0, NAN),)},
        {'goal': None},
        {'d': np.full((5, 2, 2), NAN)},
        {'d': np.empty((5, 0, 2)), 'dogs': ()},
        {'x': np.where(np.arange(4)[:, None] < [[[1, 1]]] * 5, 1.0, NAN)},
    ],
)
@pytest.mark.filterwarnings('error')
def test_picture_of_a_poor_run(run: RecordedRun, tmp_path: Path, change: dict[str, Any]) -> None:
    save_trajectories(replace(run, **change), tmp_path / 'trajectories.png')
    assert (tmp_path / 'trajectories.png').stat().st_size > 10_000


def test_every_axis_of_the_picture_is_labelled_and_every_dog_has_its_number(
    run: RecordedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(figures, 'save', lambda figure, *_, **__: drawn.append(figure))
    replans = (*run.replans, replan(3, 1.0, 'feedback'))
    save_trajectories(replace(run, replans=replans), tmp_path / 'trajectories.png')
    (figure,) = drawn
    for axes in figure.axes:
        assert axes.get_ylabel()
        assert axes.get_xlabel() or axes.get_shared_x_axes().joined(axes, figure.axes[1])
    numbers = [text.get_text() for text in figure.axes[0].texts]
    assert numbers == ['1', '2']
    kinds = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert kinds == ['windows', 'feedbacks']


def test_picture_of_a_single_state(run: RecordedRun, tmp_path: Path) -> None:
    one = replace(
        run, times=run.times[:1], x=run.x[:1, :1], v=run.v[:1, :1], d=run.d[:1, :1], dogs=(1,)
    )
    save_trajectories(one, tmp_path / 'trajectories.png')
    summarise(one)


def bag_of(run: RecordedRun, path: Path, run_recorder: Any, **custom_data: str) -> Path:
    parameters = {'/controller': {'goal': run.goal.tolist()}, **run.parameters}
    with run_recorder(path, parameters, **custom_data) as recorder:
        for k, time in enumerate(run.times):
            ns = recorder.log_ns = int(1e9 * time)
            recorder.sheep('/truth/sheep', ns, run.x[k], run.v[k])
            for m in range(run.d.shape[1]):
                recorder.odometry(f'/truth/dog_{m + 1}/odom', ns, run.d[k, m])
            recorder.publish_ns += 62_500_000
        for each in run.replans:
            recorder.diagnostics('controller: plan', 0, replan=each.number, solve_ms=each.solve_ms)
    return path


@pytest.mark.parametrize('node', ['sim', 'controller'])
def test_summary_of_dogs_that_touch_by_the_radius_in_the_bag(run: RecordedRun, node: str) -> None:
    near = closest(run.d)
    for radius, expected in ((0.49 * near, 0), (0.51 * near, 2)):
        parameters = {f'/{node}': {'bodies.radius': radius}}
        assert summarise(replace(run, parameters=parameters))['touches'] == expected
    alone = summarise(replace(run, d=run.d[:, :1], dogs=(1,)))
    assert (alone['closest_dogs_m'], alone['touches']) == (None, 0)


def test_report_of_a_bag(run: RecordedRun, tmp_path: Path, run_recorder: Any) -> None:
    bag = bag_of(run, tmp_path / 'bag', run_recorder)
    console = Console(record=True, width=120, file=StringIO())
    summary = write_report(bag, tmp_path / 'new' / 'out', console)
    assert json.loads((tmp_path / 'new' / 'out' / 'summary.json').read_text()) == summary
    assert summary == {
        **summarise(run),
        'messages_recorded': 18,
        'version': '9.8.7',
        'final_distance_m': pytest.approx(0.2),
        'max_spread_m': pytest.approx(0.7),
        'initial_spread_m': pytest.approx(0.4),
    }
    imread(tmp_path / 'new' / 'out' / 'trajectories.png')
    text = console.export_text()
    assert '/truth/dog_2/odom' in text
    assert 'sensor_msgs/msg/PointCloud2' in text
    assert 'arrived after 1.5 s' in text
    assert '3 replans' in text
    assert 'm from each other, 0 touches' in text
    assert 'left behind' not in text


def test_report_prints_what_may_be_left_behind_and_its_notes(
    run: RecordedRun, tmp_path: Path, run_recorder: Any
) -> None:
    texts = []
    for given in ({'strays': 2}, {'strays': -2}):
        bag = bag_of(with_arrival(run, **given), tmp_path / f'bag{len(texts)}', run_recorder)
        console = Console(record=True, width=120, file=StringIO())
        write_report(bag, tmp_path / 'out', console)
        texts.append(console.export_text())
    assert '4 sheep, 2 of which may be left behind, 2 dogs' in texts[0]
    assert 'note:' not in texts[0]
    assert 'note: the arrival is judged by the default parameters: Arrival.strays' in texts[1]


@pytest.mark.parametrize(
    ('said', 'lost', 'printed'),
    [('12', 12, '12 messages were lost'), ('0', 0, ''), ('many', None, ''), ('-1', None, '')],
)
def test_report_says_how_many_messages_were_lost(
    run: RecordedRun, tmp_path: Path, run_recorder: Any, said: str, lost: int, printed: str
) -> None:
    bag = bag_of(run, tmp_path / 'bag', run_recorder, messages_lost=said)
    console = Console(record=True, width=120, file=StringIO())
    assert write_report(bag, tmp_path, console)['messages_lost'] == lost
    text = console.export_text()
    assert printed in text
    assert ('lost' in text) == bool(lost)


@pytest.mark.parametrize('width', [40, 80])
def test_topics_are_whole_on_any_terminal(
    width: int, run: RecordedRun, tmp_path: Path, run_recorder: Any
) -> None:
    out = StringIO()
    bag = bag_of(run, tmp_path / 'bag', run_recorder)
    write_report(bag, tmp_path, Console(file=out, width=width))
    shown = out.getvalue().split()
    assert {'/truth/sheep', '/truth/dog_1/odom', '/truth/dog_2/odom', '/diagnostics'} < set(shown)
    assert ('sensor_msgs/msg/PointCloud2' in shown) == (width == 80)


def test_program_writes_beside_the_bag(
    run: RecordedRun, tmp_path: Path, run_recorder: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(run, tmp_path / 'bag', run_recorder)
    assert main([str(bag)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'bag', 'replay.html', 'summary.json', 'trajectories.png'
    ]  # fmt: skip
    assert 'summary.json' in capsys.readouterr().out


def test_program_says_what_it_left_out(
    run: RecordedRun, tmp_path: Path, run_recorder: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_recorder(tmp_path / 'bag') as recorder:
        recorder.advertise('/a/dog_1/odom', 'nav_msgs/msg/Odometry')
        recorder.advertise('/[red]\x1b[2J', 'std_msgs/msg/String')
        recorder.sheep('/a/sheep', 0, run.x[0], run.v[0])
        recorder.sheep('/b/sheep', 0, run.x[0], run.v[0])
        recorder.goal(0, (1, 1), '/a/goal_pose')
        recorder.goal(0, (2, 2), '/a/goal_pose', '\x1b[2J[red]')
    assert main([str(tmp_path / 'bag')]) == 2
    assert 'several namespaces, /a, /b' in capsys.readouterr().err
    assert main([str(tmp_path / 'bag'), '--namespace', 'a']) == 0
    printed = capsys.readouterr().out
    assert 'to (1, 1): did not arrive' in printed
    notes = json.loads((tmp_path / 'summary.json').read_text())['notes']
    assert len(notes) == 3
    for note in notes:
        assert f'note: {note}' in printed
    assert '[red]' in printed
    assert '\x1b' not in printed


def test_program_says_what_it_cannot_read(
    tmp_path: Path, run_recorder: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / 'nothing')]) == 2
    assert 'nothing is not a bag' in capsys.readouterr().err
    with run_recorder(tmp_path / 'bag') as recorder:
        recorder.goal(0, (0, 0))
    assert main([str(tmp_path / 'bag')]) == 2
    assert 'no states' in capsys.readouterr().err
    assert not list(tmp_path.glob('*.png'))


def test_program_says_where_it_cannot_write(
    run: RecordedRun, tmp_path: Path, run_recorder: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(run, tmp_path / 'bag', run_recorder)
    (tmp_path / 'file').write_text('')
    assert main([str(bag), '--out', str(tmp_path / 'file')]) == 2
    assert 'file' in capsys.readouterr().err


def test_a_field_is_drawn_and_its_region_judges(run: RecordedRun, tmp_path: Path) -> None:
    """The region holds all sheep from 1 s on, so for half a second at the end."""
    file = tmp_path / 'field.yaml'
    file.write_text(
        'fences: [[[-3, -3], [3, -3]]]\ndiscs: [[2, 2, 0.5]]\n'
        'goal: [[0.3, -0.9], [1.7, -0.9], [1.7, 0.9], [0.3, 0.9]]\nhold: 0.5\n'
    )
    inside = replace(run, parameters={'/sim': {'field': str(file)}})
    summary = summarise(inside)
    assert (summary['arrived'], summary['time_s'], summary['notes']) == (True, 1.5, [])
    axes = Figure().add_subplot()
    figures._draw_map(axes, inside)
    assert [
        list(line.get_xdata())
        for line in axes.lines
        if line.get_linewidth() == 1.5
        and line.get_color() == 'black'
        and len(line.get_xdata()) > 1
    ] == [[-3.0, 3.0]]
    assert len(axes.patches) == 2  # the region and the disc
    elsewhere = summarise(replace(inside, goal=np.array([0.96, 0.0])))
    assert elsewhere['time_s'] == 1.5  # the state that is home without a field
    file.write_text(file.read_text().replace('0.5\n', '1.5\n'))
    assert summarise(inside)['arrived'] is False
    file.unlink()
    (note,) = summarise(inside)['notes']
    assert 'the field is not drawn, and does not count' in note
