"""The live viewer: a run in the browser, served by viser, with our rasterizer's picture on call."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from renderer import Camera
from splatmorph.errors import MissingExtraError, OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.geometry.quaternions import to_matrices
from splatmorph.morph.ramps import DEFAULT_RAMP, RAMPS
from splatmorph.rendering import Colour, orbit, render
from splatmorph.view.scene import Scene
from splatmorph.view.subject import thin
from splatmorph.view.visitors import own_page_only

FRAME = 1 / 24
"""Seconds a playing morph stands still."""
ROUND_TRIP = 6.0
"""Seconds from source to target and back."""
LONGEST = 1280
"""Pixels of the longer side of a rasterizer's picture that is sent."""
SOURCE_COLOUR, TARGET_COLOUR = (19, 128, 124), (200, 116, 26)


def serve(
    scene: Scene,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    up: str = "y",
    background: Colour = (1.0, 1.0, 1.0),
    max_splats: int = 200_000,
) -> Viewer:
    """Serve ``scene`` at http://host:port and return at once.

    Arguments:
        host: the address to listen at; the default is reached from this machine only. Requests
            by another name and of other web pages are refused.
        port: the first port to try.
        up: the axis that is up.
        background: RGB in [0, 1] of the rasterizer's picture.
        max_splats: most splats that are sent; the rasterizer's picture has them all.

    Raises:
        MissingExtraError: viser is not installed.
        OptionError: the address can't be listened at, or other pages can't be kept out.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingExtraError("viser", "view", "the live viewer") from error
    try:
        with own_page_only(host) as guards:
            server = viser.ViserServer(host=host, port=port, label="splatmorph", verbose=False)
    except OSError as error:
        raise OptionError(f"can't listen at {host}:{port} ({error}): give another") from error
    if not guards.is_set():
        server.stop()
        raise OptionError("this version of viser lets any web page read the splats: install 1.1")
    # Sharing would lead another site's visitors here, who are refused.
    server.gui.configure_theme(show_share_button=False)
    return Viewer(server, scene, up, background, max_splats)


@dataclass(frozen=True)
class _Drawn:
    """What the splats on the clients' screens were drawn for."""

    t: float
    part: str
    ramp: str


class Viewer:
    """One server, the controls all its visitors share, and what they see."""

    def __init__(
        self, server: Any, scene: Scene, up: str, background: Colour, max_splats: int
    ) -> None:
        self.server, self.scene, self.background = server, scene, background
        self.max_splats = max_splats
        self.legs = list(scene.legs)
        self.drawn: _Drawn | None = None
        self.clock = 0.0
        self.layers: list[Any] = []
        self.seen: dict[int, tuple[Any, ...]] = {}
        self._add_controls(server.gui)
        self._place_camera(up)

    def _add_controls(self, gui: Any) -> None:
        moves = bool(self.scene.legs)
        last = float(max(1, len(self.scene.legs)))
        ramp = self.scene.legs[0].morph.ramp if moves else DEFAULT_RAMP
        parts = ("source", "morph", "target")
        self.time = gui.add_slider("t", 0.0, last, 0.01, 0.0, visible=moves)
        self.playing = gui.add_checkbox("Play", initial_value=False, visible=moves)
        self.loop = gui.add_checkbox("Loop", initial_value=True, visible=moves)
        self.part = gui.add_dropdown("Show", parts, initial_value="morph", visible=moves)
        self.ramp = gui.add_dropdown("Ramp", tuple(RAMPS), initial_value=ramp, visible=moves)
        self.marks = gui.add_checkbox("Landmarks", initial_value=False, visible=moves)
        self.true = gui.add_checkbox(
            "Rasterizer's picture",
            initial_value=False,
            hint="Draw by splatmorph's own rasterizer instead of the browser.",
        )

    @property
    def address(self) -> str:
        """Where to point a browser."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def _place_camera(self, up: str) -> None:
        bounds = self.scene.bounds()
        first = orbit(bounds, [0.0], up=up)[0]
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(first.position), tuple(bounds.center)
        camera.up = tuple(-first.viewmat[1, :3])
        camera.fov = float(2 * np.arctan(first.height / 2 / first.K[1, 1]))
        self.server.scene.set_up_direction(tuple(-first.viewmat[1, :3]))

    def run(self) -> None:
        """Follow the controls until interrupted, then stop the server."""
        import time

        try:
            while True:
                begun = time.perf_counter()
                self.step(FRAME)
                time.sleep(max(0.0, FRAME - (time.perf_counter() - begun)))
        except KeyboardInterrupt:
            return
        finally:
            self.server.stop()

    def step(self, seconds: float) -> None:
        """Let time pass and bring every screen up to date."""
        if self.playing.value:
            self._advance(seconds)
        wanted = _Drawn(self.time.value, self.part.value, self.ramp.value)
        if wanted != self.drawn:
            self._show(wanted)
            self._draw_marks()
            self.drawn = wanted
            self.seen.clear()
        for layer in self.layers:
            layer.visible = self.marks.value
        self._splats.visible = not self.true.value
        self._send_pictures()

    def _advance(self, seconds: float) -> None:
        last = len(self.scene.legs)
        self.clock = (self.clock + seconds / (ROUND_TRIP * last)) % 1
        self.time.value = round(last * (1 - np.cos(2 * np.pi * self.clock)) / 2, 2)
        if not self.loop.value and self.time.value >= last:
            self.playing.value, self.clock = False, 0.0

    def place(self) -> tuple[int, float]:
        """Which morph of the scene is shown, and its own t in [0, 1]."""
        number = min(int(self.time.value), len(self.legs) - 1)
        return number, self.time.value - number

    def splats(self, wanted: _Drawn) -> Gaussians:
        """The splat, the morph, or one side carried along at full opacity."""
        if not self.legs:
            return self.scene.splats[0]
        number, t = self.place()
        leg, place = self.legs[number], self.scene.places[number]
        if wanted.part != "morph":
            return leg.side(wanted.part, t).moved(place)
        if wanted.ramp != leg.morph.ramp:
            # Kept: what a morph finds out about its halves takes a while.
            leg = self.legs[number] = replace(leg, morph=leg.morph.with_ramp(wanted.ramp))
        return leg.morph.at(t).moved(place)

    def _show(self, wanted: _Drawn) -> None:
        self.shown = self.splats(wanted)
        kept = self.shown.select(thin(self.shown, self.max_splats))
        axes = to_matrices(kept.quats.double()) * kept.scales.double()[:, None]
        self._splats = self.server.scene.add_gaussian_splats(
            "/morph",
            centers=kept.means.float().numpy(force=True),
            covariances=(axes @ axes.mT).float().numpy(force=True),
            rgbs=(0.5 + SH0 * kept.sh[:, 0]).clamp(0, 1).float().numpy(force=True),
            opacities=kept.opacities[:, None].float().numpy(force=True),
        )

    def _draw_marks(self) -> None:
        self.layers = []
        if not self.legs:
            return
        number, t = self.place()
        marks = map(self.scene.places[number], self.legs[number].marks(t))
        colours = SOURCE_COLOUR, TARGET_COLOUR
        for name, where, colour in zip(("source", "target"), marks, colours, strict=True):
            if not len(where):
                continue
            layer = self.server.scene.add_point_cloud(
                f"/{name} landmarks",
                where.float().numpy(force=True),
                colour,
                point_size=0.012 * self.scene.bounds().radius,
                point_shape="circle",
                precision="float32",
                visible=self.marks.value,
            )
            self.layers.append(layer)

    def _send_pictures(self) -> None:
        """To every visitor whose view has changed since the last one."""
        for number, client in self.server.get_clients().items():
            if not self.true.value:
                if self.seen.pop(number, None) is not None:
                    client.scene.set_background_image(None)
                continue
            eye = client.camera
            view = (tuple(eye.wxyz), tuple(eye.position), eye.fov, eye.image_width)
            if self.seen.get(number) != view:
                self.seen[number] = view
                client.scene.set_background_image(
                    self._picture(eye), format="jpeg", jpeg_quality=90
                )

    def _picture(self, eye: Any) -> NDArray[np.uint8]:
        """What a visitor's camera sees, by our rasterizer."""
        return render(self.shown, camera_of(eye), background=self.background)


def camera_of(eye: Any) -> Camera:
    """The camera of a visitor: viser's camera → world rotation wxyz and position, fov upright."""
    rotation = to_matrices(torch.as_tensor(eye.wxyz, dtype=torch.float64))
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation.numpy().T
    viewmat[:3, 3] = -viewmat[:3, :3] @ np.asarray(eye.position)
    shrink = min(1.0, LONGEST / max(eye.image_width, eye.image_height))
    width, height = round(eye.image_width * shrink), round(eye.image_height * shrink)
    focal = height / 2 / np.tan(eye.fov / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(viewmat, K, width, height)
