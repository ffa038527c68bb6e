# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: a scene of the herd, curves, and a panel for whoever has controls.

viser serves it, without anything from elsewhere. All browsers see the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import redirect_stdout
import errno
import io
import math
import socket
from typing import Any, TypeAlias

from herding_ros.model.state import Array
from herding_ros.report.walls import outlines, region
import numpy as np

from .frame import Curve, Frame

try:
    import viser
except ModuleNotFoundError as error:  # it has no rosdep key
    raise ModuleNotFoundError('the view needs viser: pip install viser') from error

_Colour: TypeAlias = 'tuple[int, int, int]'
_Lines: TypeAlias = 'tuple[Array, np.ndarray]'
"""Segments (n, 2, 2) [m] and the colours of their ends (n, 2, 3)."""

_BLUE, _RED, _BLACK = (33, 102, 172), (194, 41, 43), (0, 0, 0)
_DARK, _PALE, _GREEN = (60, 60, 60), (170, 170, 170), (110, 190, 120)
_LIT_RED = (255, 30, 30)
"""What looks red on a mesh, which viser's light makes paler than lines."""
_WHITE = np.full(3, 255.0)

_LINEAR = np.rint(255.0 * (np.arange(256) / 255.0) ** 2.2).astype(np.uint8)
"""From colours to those of lines, of which viser believes that they are linear."""

_FIELD_OF_VIEW = 0.5
"""Of the camera, from the bottom to the top of the picture [rad]."""

_MOST_NUMBERS = 60
"""More dogs than this go without their numbers: nobody could read them."""

_DOG = np.array([[1.3, 0.0, 0.0], [-0.9, 0.8, 0.0], [-0.9, -0.8, 0.0]])
"""A dog that heads along x."""

_PORTS = 100
"""Ports that are tried."""

_MOST_AHEAD = 40
"""Points of a planned way that are drawn: without a graphics card each segment takes time."""

_NO_LINES: _Lines = np.zeros((0, 2, 2)), np.zeros((0, 2, 3), np.uint8)

_CROSS = np.array([[[-1.0, -1.0], [1.0, 1.0]], [[-1.0, 1.0], [1.0, -1.0]]])


class Page:
    """A page at `url`; it draws only while a browser is there."""

    def __init__(self, host: str, port: int, title: str, curves: Sequence[Curve]) -> None:
        """Serve at a port of this machine, or the next that is free; ValueError if none is.

        host: the address at which others reach it, '127.0.0.1' for this machine alone. curves:
        `draw_curves` draws them as they are then.
        """
        free = _free_port(host, port)  # viser would wait for ever where there is none
        with redirect_stdout(io.StringIO()):  # a box with addresses that is not ours
            self._server = viser.ViserServer(host=host, port=free, verbose=False)
        self.url = f'http://{host}:{self._server.get_port()}'
        self.gui = self._server.gui
        self.gui.configure_theme(show_logo=False, show_share_button=False)
        self.gui.set_panel_label(title)
        self.gui.main_panel.dock_right()  # beside the herd, not above it
        self._curves = curves
        self._plots: list[viser.GuiUplotHandle] = []
        self._scene = _Scene(self._server)

    @property
    def browsers(self) -> int:
        """How many browsers show it."""
        return len(self._server.get_clients())

    def on_click(self, take: Callable[[Array], None]) -> None:
        """Call take(place (2,) [m]) where somebody clicks on the field."""

        @self._server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            place = on_the_ground(event.ray_origin, event.ray_direction)
            if place is not None:
                take(place)

    def show(self, frame: Frame) -> None:
        """Draw the herd."""
        with self._server.atomic():
            self._scene.draw(frame)

    def add_camera_button(self) -> None:
        """Add a button that lets all browsers look at the whole herd, from above."""
        button = self.gui.add_button('look at the whole herd')
        button.on_click(lambda _: self._scene.look_at_all())

    def add_text(self) -> Callable[[str], None]:
        """Add a line to the panel; what is returned changes it."""
        handle = self.gui.add_markdown('')

        def write(text: str) -> None:
            if handle.content != text:
                handle.content = text

        return write

    def add_curves(self) -> None:
        """Add the curves to the panel."""
        for curve in self._curves:
            self._plots.append(
                self.gui.add_uplot(
                    _plotted(curve),
                    ({'label': 'time [s]'}, {'label': curve.label, 'stroke': '#2166ac'}),
                    title=curve.label,
                    scales={'x': {'time': False}},
                    axes=({'size': 30}, {'size': 55}),
                    legend={'show': False},
                    height=95,
                )
            )

    def draw_curves(self) -> None:
        """Draw the curves as they are now."""
        for curve, plot in zip(self._curves, self._plots, strict=True):
            plot.data = _plotted(curve)

    def warn(self, text: str) -> None:
        """Tell every browser that something was refused or did not happen."""
        for client in self._server.get_clients().values():
            client.add_notification('', text, color='red', auto_close_seconds=10.0)

    def close(self) -> None:
        """End; browsers show that they are not connected any more."""
        self._server.stop()


def _free_port(host: str, first: int) -> int:
    """Return the first port from `first` on that nobody uses; ValueError if there is none."""
    for port in range(first, min(first + _PORTS, 65536)):
        try:
            with socket.create_server((host, port)):
                return port
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise ValueError(
                    f'host and port must be an address of this machine that may be used, got '
                    f'{host}:{port}: {error.strerror}'
                ) from None
    raise ValueError(f'port must be free, or one of the {_PORTS} after it, got {first}')


def _plotted(curve: Curve) -> tuple[np.ndarray, ...]:
    """Return times and values; a plot needs two points at least."""
    empty = len(curve.times) < 2
    return (
        np.array([0.0, 1.0] if empty else curve.times),
        np.array([np.nan, np.nan] if empty else curve.values),
    )


def on_the_ground(origin: Sequence[float], direction: Sequence[float]) -> Array | None:
    """Return where (2,) a ray from `origin` (3,) hits z = 0, None where it does not."""
    start, along = np.asarray(origin, float), np.asarray(direction, float)
    if along[2] == 0.0 or start[2] / along[2] > 0.0:
        return None
    return (start - start[2] / along[2] * along)[:2]


def faded(base: tuple[int, int, int], strength: Array) -> np.ndarray:
    """Return colours (..., 3) from white, at strength 0, to a base, at 1."""
    return (_WHITE + strength[..., None] * (np.array(base) - _WHITE)).astype(np.uint8)


def thinned(points: Array, most: int) -> Array:
    """Return at most so many of points (K, ...), the first and the last included."""
    kept = np.linspace(0, len(points) - 1, min(len(points), most))
    return points[np.rint(kept).astype(int)]


def polylines(points: Array) -> Array:
    """Return polylines (K, M, 2) as their segments (n, 2, 2)."""
    return np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 2)


class _Scene:
    """The herd in viser's scene; its sizes follow from where all were when first seen."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._scene = server.scene
        self._size = 0.0
        self._known: object = None
        self._handles: dict[str, Any] = {}
        self._labels: tuple[int, ...] = ()
        self._box: Array = np.zeros((2, 2))
        # Light from everywhere: colours are what they are.
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient('/light', intensity=1.8)

    def draw(self, frame: Frame) -> None:
        self._box = _box(frame)
        known = (frame.numbers, frame.goal is not None, frame.field)
        if known != self._known:  # others, who may be far away
            self._known = known
            self._begin()
        self._draw_sheep(frame)
        self._draw_dogs(frame)
        ways = (
            _plain(polylines(frame.surroundings.route[:, None]), _GREEN),
            _fading(frame.dog_trails, _RED, 0.25, rises=True),
            _fading(frame.centre_trail[:, None], _BLUE, 0.5, rises=True),
            _fading(thinned(frame.plans, _MOST_AHEAD), _RED),
            _fading(thinned(frame.expected[:, None], _MOST_AHEAD), _BLUE),
        )
        below = -0.05 * self._size
        self._draw_lines('ways', 2.0, ways, below)
        self._draw_lines('marks', 4.0, _marks(frame, self._size), below)

    def _begin(self) -> None:
        """Begin a new picture, as large as the herd is now."""
        for handle in self._handles.values():
            handle.remove()
        self._handles, self._labels = {}, ()
        self._size = 0.012 * float(np.ptp(self._box, axis=0).max())
        self._add_grid()
        self.look_at_all()

    def look_at_all(self) -> None:
        """Set the camera, of browsers to come and of those that are here."""
        low, high = self._box
        x, y = 0.5 * (low + high)
        height = 0.75 * float((high - low).max()) / math.tan(0.5 * _FIELD_OF_VIEW)
        first = self._server.initial_camera
        first.up = (0.0, 1.0, 0.0)
        others = [client.camera for client in self._server.get_clients().values()]
        for camera in (first, *others):
            camera.fov = _FIELD_OF_VIEW
            camera.near, camera.far = 0.01 * height, 100.0 * height
            camera.position, camera.look_at = (x, y, height), (x, y, 0.0)
        for camera in others:
            camera.up_direction = (0.0, 1.0, 0.0)

    def _add_grid(self) -> None:
        low, high = self._box
        side = float((high - low).max())
        step = 10.0 ** math.floor(math.log10(side / 2.0))
        first, last = (np.rint(each / step) for each in (low - 2.5 * side, high + 2.5 * side))
        for name, every, grey in (('grid', 1, 235), ('sections', 5, 215)):
            lines = _grid(first, last, every)
            self._draw_lines(name, 1.0, [_plain(step * lines, (grey,) * 3)], -0.1 * self._size)
        # Where the lines with numbers cross, one reads how long things are.
        middle = np.rint(0.5 * (low + high) / step / 5.0)
        for k in range(-1, 3):
            x, y = 5.0 * step * (middle + k)
            for axis, value, at in (('x', x, (x, low[1])), ('y', y, (low[0], y))):
                self._scene.add_label(
                    f'/scale/{axis}{k}', f'{axis} = {value:g} m', font_screen_scale=0.7,
                    position=(*at, 0.0),
                )  # fmt: skip

    def _draw_sheep(self, frame: Frame) -> None:
        points = _placed(frame.x)
        handle = self._handles.get('sheep')
        if handle is None:
            # So small that one sees many of them.
            apart = float(np.ptp(frame.x, axis=0).max()) / math.sqrt(len(points))
            self._handles['sheep'] = self._scene.add_point_cloud(
                '/sheep', points, _BLUE, point_size=min(self._size, apart) or self._size,
                point_shape='circle', point_shading='flat', precision='float32',
            )  # fmt: skip
        else:
            handle.points = points

    def _draw_dogs(self, frame: Frame) -> None:
        d, headings, numbers = frame.d, frame.headings, frame.numbers
        there = np.isfinite(d[:, 0])
        d, headings = d[there], headings[there]
        numbers = tuple(number for number, here in zip(numbers, there, strict=True) if here)
        if not numbers and 'dogs' not in self._handles:
            return
        turns = np.zeros((len(d), 4))
        turns[:, 0], turns[:, 3] = np.cos(0.5 * headings), np.sin(0.5 * headings)
        at = _placed(d, 0.2 * self._size)
        if numbers != self._labels or 'dogs' not in self._handles:
            self._name_dogs(numbers, at)
            self._handles['dogs'] = self._scene.add_batched_meshes_simple(
                '/dogs', 1.5 * self._size * _DOG, np.array([[0, 1, 2]]), turns, at,
                batched_colors=_LIT_RED, side='double', lod='off',
                material='toon3',  # a few lines of shader: the standard one has a thousand
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            return
        dogs = self._handles['dogs']
        dogs.batched_positions, dogs.batched_wxyzs = at, turns
        for number, place in zip(numbers, at, strict=True):
            if label := self._handles.get(f'dog {number}'):
                label.position = place

    def _name_dogs(self, numbers: tuple[int, ...], at: Array) -> None:
        for number in self._labels:
            if label := self._handles.pop(f'dog {number}', None):
                label.remove()
        self._labels = numbers
        if len(numbers) <= _MOST_NUMBERS:
            for number, place in zip(numbers, at, strict=True):
                self._handles[f'dog {number}'] = self._scene.add_label(
                    f'/number/{number}', str(number), position=place, anchor='bottom-left'
                )

    def _draw_lines(
        self, name: str, pixels: float, lines: Iterable[_Lines], height: float = 0.0
    ) -> None:
        """Draw lines of one width as one object: each costs time, whatever is in it.

        Of two that cross the later is above.
        """
        segments, colours = (np.concatenate(each) for each in zip(_NO_LINES, *lines, strict=True))
        if not len(segments):
            if handle := self._handles.pop(name, None):
                handle.remove()
            return
        points = _placed(segments.reshape(-1, 2), height).reshape(-1, 2, 3)
        colours = _LINEAR[colours]
        if handle := self._handles.get(name):
            handle.points, handle.colors = points, colours
        else:
            self._handles[name] = self._scene.add_line_segments(
                f'/{name}', points, colours, thickness=pixels, thickness_units='screen'
            )


def _fading(points: Array, colour: _Colour, weight: float = 1.0, rises: bool = False) -> _Lines:
    """Return polylines (K, M, 2) that fade towards their end, or rise to it."""
    segments = polylines(points)
    count = max(len(points) - 1, 0)
    strength = np.linspace(0.0, 1.0, count + 1) if rises else np.linspace(1.0, 0.1, count + 1)
    of_each = np.stack([strength[:-1], strength[1:]], axis=1)  # (count, 2)
    of_all = np.repeat(of_each, points.shape[1], axis=0)
    seen = np.isfinite(segments).all(axis=(1, 2))
    return segments[seen], faded(colour, weight * of_all[seen])


def _marks(frame: Frame, size: float) -> Iterator[_Lines]:
    """Yield the walls, the region that has to hold the flock, and the cross of the destination."""
    yield _plain(frame.surroundings.walls, _DARK)
    for line in outlines(frame.field):
        yield _plain(polylines(line[:, None]), _DARK)
    corners = region(frame.field)
    if len(corners):
        yield _plain(polylines(corners[:, None]), _PALE)
    if frame.goal is not None:
        yield _plain(frame.goal + 1.5 * size * _CROSS, _BLACK)


def _grid(first: Array, last: Array, every: int) -> Array:
    """Return the lines (n, 2, 2) of a grid through multiples of `every`, between two corners."""
    segments = []
    for across, along in ((0, 1), (1, 0)):
        at = every * np.arange(np.ceil(first[across] / every), last[across] / every)
        lines = np.empty((len(at), 2, 2))
        lines[:, :, across] = at[:, None]
        lines[:, :, along] = first[along], last[along]
        segments.append(lines)
    return np.concatenate(segments)


def _plain(segments: Array, colour: _Colour) -> _Lines:
    """Return segments (n, 2, 2) [m] of one colour."""
    return segments, np.full((len(segments), 2, 3), colour, np.uint8)


def _placed(places: Array, height: float = 0.0) -> np.ndarray:
    """Return places (n, 2) in three dimensions, (n, 3)."""
    return np.concatenate([places, np.full((len(places), 1), height)], axis=1).astype(np.float32)


def _box(frame: Frame) -> Array:
    """Return the lower left and the upper right corner (2, 2) [m] around all there is."""
    goal = np.zeros((0, 2)) if frame.goal is None else frame.goal[None]
    everything = np.concatenate([frame.x, frame.d, goal, *outlines(frame.field)])
    everything = everything[np.isfinite(everything).all(axis=1)]
    box = np.array([everything.min(axis=0), everything.max(axis=0)])
    if not np.ptp(box, axis=0).any():
        box += np.array([[-0.5], [0.5]])
    return box
