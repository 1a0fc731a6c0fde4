"""The page that shows a history, and its buttons: a thin layer over viser."""

from __future__ import annotations

import html
import io
import ipaddress
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DOF_UNITS, DOFS, quaternions_xyzw
from servoscope.positioning.interfaces import Array
from servoscope.viewer.history import History, Series
from servoscope.viewer.way import COLOURS

if TYPE_CHECKING:
    import viser

LOOPBACK = "127.0.0.1"
PORT = 8080

_BOX = (110, 60, 160)
_RED, _BLUE, _GREY = (200, 50, 40), (30, 110, 200), (120, 120, 120)
_PATH = (230, 150, 30)
_PLOT_HEIGHT = 120
_FRUSTUM = 0.12
"""Size of a camera as a share of its distance from the part."""

_PLANNED = 0.4
"""Size of a planned camera beside one that was."""

_GAP = 4
_MOST_PORTS = 50


class Player(Protocol):
    """What the buttons command."""

    def step(self) -> None:
        """Go on to the next look, and wait there."""

    def run(self) -> None:
        """Go on until the end."""

    def stop(self) -> None:
        """Go no further."""

    def seek(self, k: int) -> None:
        """Show look `k`."""


class Browser:
    """A page at ``http://host:port`` that shows a history.

    Pages of other origins cannot press its buttons, and it cannot be shared through viser's
    public tunnel: a robot may hang on it.

    Parameters
    ----------
    history : History
    host : str
        Address that is listened at; this machine alone can reach the default.
    port : int
        The next free one is taken if it is in use; 0 for any.

    Attributes
    ----------
    on_alone : callable
        Called when the last page was closed.

    Raises
    ------
    InvalidInputError
        If viser is not installed, the host is not one address of this machine, or no port is free.
    """

    def __init__(self, history: History, host: str = LOOPBACK, port: int = PORT) -> None:
        self.history = history
        self.current = 0
        self._player: Player | None = None
        self._lock = threading.RLock()
        self.server = _served(host, port)
        self.on_alone: Callable[[], object] = lambda: None
        self.server.on_client_disconnect(self._left)
        try:
            self._lay_out()
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = self.server.get_host()
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.server.get_port()}"

    @property
    def is_of_this_machine(self) -> bool:
        """Whether no other machine can reach it."""
        return ipaddress.ip_address(self.server.get_host()).is_loopback

    def close(self) -> None:
        """Serve no longer."""
        with redirect_stdout(io.StringIO()):  # viser prints that it ends
            self.server.stop()

    def _lay_out(self) -> None:
        setting, server = self.history.setting, self.server
        self._size = _FRUSTUM * setting.distance
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.set_panel_label("servoscope view")
        server.scene.set_up_direction("-y")
        server.initial_camera.position = tuple(setting.distance * np.array([0.75, -0.6, -0.35]))
        server.initial_camera.look_at = (0.1 * setting.distance, 0.0, 0.5 * setting.distance)
        self._relief()
        self._cameras()
        self._way()
        self._controls()

    def _left(self, _: object) -> None:
        if not self.server.get_clients():
            self.on_alone()

    def _relief(self) -> None:
        relief = self.history.setting.relief
        if relief is None:
            return
        self.points = self.server.scene.add_point_cloud(
            "/relief", relief.points, relief.colours("image"), precision="float32",
            point_size=1.2 * relief.spacing, point_shading="flat",
        )  # fmt: skip

    def _cameras(self) -> None:
        setting, scene = self.history.setting, self.server.scene
        height, width = setting.reference_image.shape
        shape: dict[str, Any] = {
            "fov": setting.field_of_view,
            "aspect": width / height,
            "thickness": 0.02 * self._size,
        }
        reference = _rgb(setting.reference_image)
        scene.add_camera_frustum(
            "/reference", scale=self._size, color=_GREY, image=reference, **shape
        )
        self.camera = scene.add_camera_frustum(
            "/camera", scale=self._size, color=_RED, image=reference, visible=False, **shape
        )
        self.next_camera = scene.add_camera_frustum(
            "/next", scale=0.8 * self._size, color=_BLUE, visible=False, **shape
        )

    def _way(self) -> None:
        """The plan of an acquisition: its path, its cameras, and the box that it keeps to."""
        way, setting, scene = self.history.way, self.history.setting, self.server.scene
        if way is None:
            return
        thin = 0.01 * self._size
        scene.add_line_segments("/plan/path", way.path(), _GREY, thickness=thin)
        height, width = setting.reference_image.shape
        wires = way.cameras(setting.field_of_view, width / height, _PLANNED * self._size)
        self.planned = scene.add_line_segments(
            "/plan/cameras", wires.reshape(-1, 2, 3), COLOURS["planned"], thickness=2 * thin
        )
        if len(box := way.box()):
            scene.add_line_segments("/workspace", box, _BOX, thickness=3 * thin)

    def _controls(self) -> None:
        gui, setting = self.server.gui, self.history.setting
        self.step_button = gui.add_button("Step")
        self.run_button = gui.add_button("Run")
        self.stop_button = gui.add_button("Stop", color="red")
        self.status = gui.add_html("")  # below: the buttons stay where they are
        self.step_button.on_click(lambda _: self._command("step"))
        self.run_button.on_click(lambda _: self._command("run"))
        self.stop_button.on_click(lambda _: self._command("stop"))
        self.slider: Any = gui.add_slider("look", 1, 2, 1, 1, disabled=True)
        self.slider.on_update(lambda _: self._seek())
        if setting.relief is not None:
            self.colour = gui.add_dropdown("relief", ("image", "depth", "trust"))
            self.colour.on_update(lambda _: self._recolour())
        blank = np.full((*setting.reference_image.shape, 3), 255, np.uint8)
        self.images = gui.add_image(
            _side_by_side(_rgb(setting.reference_image), blank, blank),
            label="reference, image, image less reference",
            format="png",
        )
        knows_truth = self.history.knows_truth
        nothing = _columns(Series(*np.zeros((5, 1))), knows_truth)
        self.plots = {
            dof: gui.add_uplot(nothing, height=_PLOT_HEIGHT, **_plot_options(dof, knows_truth))
            for dof in DOFS
            if dof in setting.dofs
        }

    def command(self, player: Player) -> None:
        """Let the buttons and the slider command a player from now on."""
        self._player = player

    def say(self, words: str) -> None:
        """Show how it stands, a paragraph a line, beside the buttons."""
        self.status.content = "".join(
            f"<p style='padding:0 1em;margin:.5em 0'>{html.escape(line)}</p>"
            for line in words.splitlines()
        )

    def allow(self, *, step: bool, run: bool) -> None:
        """Let Step and Run be pressed, or not; Stop always can be."""
        self.step_button.disabled, self.run_button.disabled = not step, not run

    def show(self, k: int) -> None:
        """Show look `k` of the history, from 0, and all that is known of the others."""
        history, look = self.history, self.history.looks[k]
        with self._lock, self.server.atomic():
            self.current = k
            _put(self.camera, look.camera)
            self.camera.image = _rgb(look.image)
            if look.next_camera is not None:
                _put(self.next_camera, look.next_camera)
            self.next_camera.visible = look.next_camera is not None
            self._draw_path(history.path())
            self.images.image = _side_by_side(
                _rgb(history.setting.reference_image), _rgb(look.image), history.difference(k)
            )
            for dof, plot in self.plots.items():
                plot.data = _columns(history.series(dof), history.knows_truth)
            self._move_slider()

    def mark(self, taken: tuple[int, ...], refused: tuple[int, ...]) -> None:
        """Show which images of a plan are taken, and which were refused."""
        if self.history.way is not None:
            self.planned.colors = self.history.way.colours(taken, refused).reshape(-1, 2, 3)

    def _draw_path(self, path: Array) -> None:
        if len(path) < 2:
            return
        segments = np.stack([path[:-1], path[1:]], axis=1)
        self.server.scene.add_line_segments("/path", segments, _PATH, thickness=0.04 * self._size)

    def _move_slider(self) -> None:
        n_looks = len(self.history.looks)
        self.slider.max, self.slider.disabled = max(n_looks, 2), n_looks < 2
        self.slider.value = self.current + 1

    def _seek(self) -> None:
        with self._lock:
            k = int(self.slider.value) - 1
            if self._player is not None and k != self.current:
                self._player.seek(k)

    def _recolour(self) -> None:
        relief = self.history.setting.relief
        if relief is not None:
            self.points.colors = relief.colours(self.colour.value)

    def _command(self, what: str) -> None:
        if self._player is not None:
            getattr(self._player, what)()


def _put(camera: viser.CameraFrustumHandle, pose: Array) -> None:
    x, y, z, w = quaternions_xyzw(pose)
    camera.wxyz, camera.position = np.array([w, x, y, z]), pose[:3, 3]
    camera.visible = True


def _rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[:, :, None], 3, axis=2)


def _side_by_side(*images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    gap = np.full((images[0].shape[0], _GAP, 3), 255, np.uint8)
    parts = [part for image in images for part in (gap, image)]
    return np.concatenate(parts[1:], axis=1)


def _columns(series: Series, knows_truth: bool) -> tuple[Array, ...]:
    columns = series.number, series.low, series.high, series.believed, series.truth
    return columns[: 4 + knows_truth]


def _plot_options(dof: str, knows_truth: bool) -> dict[str, Any]:
    bare = {"points": {"show": False}, "stroke": "transparent"}
    series = (
        {"label": "look"},
        {"label": "low", **bare},
        {"label": "high", **bare},
        {"label": "believed", "stroke": "rgb(200,50,40)", "width": 2},
        {"label": "true", "stroke": "rgb(20,130,60)", "width": 2, "dash": [4, 4]},
    )
    return {
        "title": f"{dof} [{DOF_UNITS[dof]}]",
        "series": series[: 4 + knows_truth],
        "bands": ({"series": (2, 1), "fill": "rgba(200,50,40,0.2)"},),
        "scales": {"x": {"time": False}},
        "legend": {"show": False},
    }


def _served(host: str, port: int) -> viser.ViserServer:
    """A viser server that listens at an address."""
    try:
        import viser
    except ImportError as error:
        raise InvalidInputError(
            'The viewer needs viser; install it with: pip install "servoscope[view]".'
        ) from error

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            return None

    host, port = _free(host, port)
    with _from_own_pages(host), redirect_stdout(io.StringIO()):  # it prints its addresses
        return Server(host=host, port=port, verbose=False)


def _free(host: str, port: int) -> tuple[str, int]:
    """The address, and the first port there from this one on that is free.

    Raises
    ------
    InvalidInputError
        If the host is not one address of this machine, or no such port is free. What listens at
        every address is reached from networks that nobody named.
    """
    try:
        address = ipaddress.ip_address(LOOPBACK if host == "localhost" else host)
    except ValueError:
        address = None
    if address is None or address.is_unspecified:
        raise InvalidInputError(
            f"--host must be one address of this machine, such as {LOOPBACK}, got {host!r}."
        )
    if not 0 <= port <= 65535:
        raise InvalidInputError(f"--port must be a number from 0 to 65535, got {port}.")
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    for tried in range(port, min(port + _MOST_PORTS, 65536)):
        try:
            socket.create_server((str(address), tried), family=family).close()
            return str(address), tried
        except OSError as error:
            reason = error.strerror
    raise InvalidInputError(
        f"Nothing can listen at {address}, ports {port} to {tried} ({reason}); --host must be an "
        "address of this machine, --port a port that is free."
    )


@contextmanager
def _from_own_pages(host: str) -> Iterator[None]:
    """Let a server that starts meanwhile take connections of its own pages alone.

    viser takes those of every page in the browser, also of a site that was opened in another tab.
    """
    import websockets.asyncio.server as server

    names = {"localhost", "127.0.0.1", "[::1]", f"[{host}]" if ":" in host else host}
    pattern = "|".join(re.escape(name) for name in sorted(names))
    serve = server.serve
    server.serve = partial(serve, origins=[re.compile(rf"https?://({pattern})(:\d+)?")])  # type: ignore[misc, assignment]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
