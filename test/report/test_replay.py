# SPDX-License-Identifier: Apache-2.0
"""The page that plays a run: what is packed into it, and that a browser plays it."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
import io
from pathlib import Path
import re
import sys
import time
from typing import Any

from herding_ros.bag.recorded_run import in_play
from herding_ros.markers import Surroundings
from herding_ros.model.field import Field, read_field
from herding_ros.report.animation import save_animation
from herding_ros.report.replay import packed, save_replay
from herding_ros.report.walls import outlines, region
from moving_flock import a_run
import numpy as np
from PIL import Image
import pytest

BLUE, RED = (33, 102, 172), (194, 41, 43)


def unpacked(data: dict[str, Any], text: str, *shape: int) -> np.ndarray:
    values = np.frombuffer(b64decode(text), '<i2').reshape(*shape, 2)
    places = data['origin'] + values * data['unit']
    return np.where(values == -32768, np.nan, places)


def test_packed_places_are_those_of_the_run() -> None:
    run = a_run()
    run.d[40:60, 1] = np.nan  # silent
    data = packed(run)
    assert data['unit'] < 1e-4 * np.ptp(data['box'])
    for name, places in (('x', run.x), ('d', run.d)):
        found = unpacked(data, data[name], *places.shape[:2])
        assert np.allclose(found, places, rtol=0, atol=data['unit'], equal_nan=True)
    times = np.frombuffer(b64decode(data['times']), '<f4')
    assert np.allclose(times, run.times)
    assert data['goals'] == [[0.0, 2.0, 0.0], [5.0, 1.0, 1.0]]


def test_packed_plans_are_those_that_are_in_play() -> None:
    run = a_run()
    data = packed(run)
    starts = np.frombuffer(b64decode(data['plans']['starts']), '<f4')
    points = unpacked(data, data['plans']['points'], len(starts), data['plans']['length'], 3)
    for now in (0.0, 3.7, 8.9):
        p = int(np.searchsorted(starts, now, side='right')) - 1
        route = in_play(run.plans, now)
        assert route is not None
        times = np.linspace(route.times[0], route.times[-1], data['plans']['length'])
        for m in range(2):
            expected = [np.interp(times, route.times, route.points[:, m, i]) for i in range(2)]
            assert np.allclose(points[p, :, m], np.transpose(expected), atol=1e-3)
        assert np.allclose(points[p, :, 2], points[p, :, 0], atol=1e-3)  # the centre


def test_walls_that_the_controller_meets_are_packed_with_their_time() -> None:
    """Not those of the field, which are drawn all along; however many, they are not too many."""
    met = np.array([[[0.0, 0.5], [1.0, 0.5]]])
    pen, _ = read_field('pen')
    route = np.zeros((0, 2))
    seen = ((0.5, pen.outline), (2.0, np.concatenate([pen.outline, met])), (4.0, pen.outline))
    surroundings = tuple((since, Surroundings(walls, route)) for since, walls in seen)
    run = replace(a_run(), surroundings=surroundings, parameters={'/sim': {'field': 'pen'}})
    assert packed(run)['further'] == [[2.0, met.tolist()], [4.0, []]]
    many = tuple((0.1 * k, Surroundings(met + 0.1 * k, route)) for k in range(20_000))
    assert 2000 < len(packed(replace(a_run(), surroundings=many))['further']) <= 5000


@pytest.mark.parametrize(
    ('states', 'sheep', 'dogs', 'plans'), [(2000, 1200, 6, 300), (2, 1, 1, 0)]
)
def test_page_is_small_whatever_the_run(
    tmp_path: Path, states: int, sheep: int, dogs: int, plans: int
) -> None:
    page = tmp_path / 'replay.html'
    save_replay(a_run(states, sheep, dogs, plans), page)
    assert page.stat().st_size < 2_000_000


def test_page_needs_nothing_but_itself(tmp_path: Path) -> None:
    page = tmp_path / 'replay.html'
    save_replay(a_run(), page)
    assert not re.search('(src|href|url|import|fetch)[=(]|https?:', page.read_text())


def test_walls_of_the_field_are_packed_if_its_file_can_be_one(tmp_path: Path) -> None:
    run = a_run()
    shipped = packed(replace(run, parameters={'/sim': {'field': 'pen'}}))
    field, _ = read_field('pen')
    assert shipped['walls'] == [[list(point) for point in fence] for fence in field.fences]
    assert shipped['region'][0] == shipped['region'][-1]
    assert shipped['box'][1][0] >= max(x for fence in field.fences for x, _ in fence)
    own = tmp_path / 'own.yaml'
    own.write_text('fences: [[[0, 0], [1, 1]]]')

    def walls(file: object) -> object:
        return packed(replace(run, parameters={'/sim': {'field': str(file)}}))['walls']

    assert walls(own) == [[[0.0, 0.0], [1.0, 1.0]]]
    own.write_text('#' * 1_000_001)
    assert walls(own) == walls('/dev/zero') == walls(tmp_path) == []


def test_outlines_of_obstacles_and_discs_are_closed() -> None:
    field = Field(obstacles=(((0, 0), (1, 0), (0, 1)),), discs=((2.0, 3.0, 0.5),))
    for line in outlines(field):
        assert np.allclose(line[0], line[-1])
    assert np.allclose(np.linalg.norm(outlines(field)[1] - [2.0, 3.0], axis=1), 0.5)
    assert region(field).shape == (0, 2)


def picture(browser: Any) -> np.ndarray:
    shot = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert('RGB')
    return np.asarray(shot).astype(float)


def test_browser_plays_it(browser: Any, tmp_path: Path) -> None:
    page = tmp_path / 'replay.html'
    save_replay(a_run(), page)
    browser.get_log('browser')  # of other pages
    browser.get(page.as_uri())

    def until(condition: Callable[[], object]) -> None:
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.05)

    def at() -> float:
        found = browser.execute_script("return document.getElementById('said')?.textContent ?? ''")
        return float(re.match(r'([\d.]+) of 10\.0 s', found)[1]) if 'of' in found else -1.0

    until(lambda: at() > 1.0)
    shown = picture(browser)
    for colour, least in ((BLUE, 100), (RED, 100), ((0, 0, 0), 50)):
        assert (np.linalg.norm(shown - colour, axis=-1) < 40.0).sum() > least, colour
    until(lambda: at() == 10.0)
    # Its slider goes back, and the sheep with it.
    move = "const s = document.getElementById('time'); s.value = 2; s.oninput();"
    browser.execute_script(move)
    assert at() == 2.0

    def column() -> float:
        blue = np.linalg.norm(picture(browser)[:, :800] - BLUE, axis=-1) < 40.0
        return float(np.argwhere(blue)[:, 1].mean())

    early = column()
    browser.execute_script(move.replace('= 2', '= 9'))
    assert column() > early + 20.0
    assert [each for each in browser.get_log('browser') if each['level'] == 'SEVERE'] == []


def test_animation_shows_the_run_from_its_start_to_its_end(tmp_path: Path) -> None:
    file = tmp_path / 'run.gif'
    save_animation(a_run(states=4), file)
    with Image.open(file) as found:
        assert found.n_frames == 4
        blue = []
        for k in (0, 3):
            found.seek(k)
            shown = np.asarray(found.convert('RGB')).astype(float)
            blue.append(np.argwhere(np.linalg.norm(shown - BLUE, axis=-1) < 60.0)[:, 1].mean())
    assert blue[1] > blue[0] + 50.0
    with pytest.raises(ValueError, match=r'must end in \.gif or \.mp4, got run\.avi'):
        save_animation(a_run(), tmp_path / 'run.avi')


def a_program(folder: Path, name: str, lines: str) -> None:
    program = folder / name
    program.write_text(f'#!{sys.executable}\n{lines}')
    program.chmod(0o755)


def test_film_is_what_ffmpeg_makes_of_whole_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = tmp_path / 'run.mp4'
    with pytest.MonkeyPatch.context() as without:
        without.setenv('PATH', str(tmp_path))
        with pytest.raises(ValueError, match='needs ffmpeg, which is not installed'):
            save_animation(a_run(states=4), film)
    program = """
import re, sys
words, sent = ' '.join(sys.argv), sys.stdin.buffer.read()
width, height = map(int, re.search(r'-s (\\d+)x(\\d+)', words).groups())
assert 'rawvideo -pix_fmt rgb24' in words and width % 2 == height % 2 == 0
open(sys.argv[-1], 'w').write(f'{len(sent) / (3 * width * height)}')
"""
    a_program(tmp_path, 'ffmpeg', program)
    monkeypatch.setenv('PATH', f'{tmp_path}')
    save_animation(a_run(states=4), film)
    assert film.read_text() == '4.0'
    a_program(tmp_path, 'ffmpeg', "import sys; sys.exit('the disk is full')")
    with pytest.raises(OSError, match=r'could not write .*run\.mp4: the disk is full'):
        save_animation(a_run(states=4), film)
