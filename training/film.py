"""The map growing view by view, as an animated GIF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..agents import StepRecord
from .figures import COLOURS, FAINT, INK, depth_colormap, label
from .plans import region_of
from .voxel_painter import VoxelPainter, uncertainty_colours

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

    from ..envs.env import NbvEnv

SIZE = (1000, 640)
#: Width of the column with image, curve and numbers.
COLUMN = 270
MARGIN = 22
FRAME_MS, LAST_MS = 280, 3000
#: Whole frames from which the palette is made.
MAPS_IN_PALETTE = 4
HEAD = 58
#: How much larger lines and letters are drawn than they are shown.
FINE = 3
PAPER = (255, 255, 255)
CAMERA_COLOUR, WAY_COLOUR = (24, 90, 188), (36, 41, 47)
#: How far the drawn camera pyramid reaches, metres.
PYRAMID = 0.45


class Pen:
    """Draws in the picture's pixels onto a layer that is `FINE` times as large."""

    def __init__(self, draw: ImageDraw) -> None:
        self._draw = draw

    def line(self, points: Sequence[tuple[float, float]], fill: Any, width: float = 1.0) -> None:
        fine = [(x * FINE, y * FINE) for x, y in points]
        self._draw.line(fine, fill=fill, width=max(1, round(width * FINE)), joint="curve")

    def disc(self, x: float, y: float, radius: float, fill: Any, outline: Any) -> None:
        box = tuple(FINE * v for v in (x - radius, y - radius, x + radius, y + radius))
        self._draw.ellipse(box, fill=fill, outline=outline, width=FINE)

    def text(self, place: tuple[float, float], text: str, fill: Any, size: int, bold: bool = False, anchor: str = "la") -> None:
        x, y = place
        self._draw.text((x * FINE, y * FINE), text, fill=fill, font=font(size * FINE, bold), anchor=anchor)


class Film:
    """An observer of a rollout that paints one frame per view."""

    def __init__(self, title: str, ceiling_above_floor: float | None = None) -> None:
        self.title = title
        self.ceiling = ceiling_above_floor
        self.frames: list[Image] = []
        self._painter: VoxelPainter | None = None
        self._coverage: list[float] = []
        self._way: list[NDArray[np.float32]] = []

    def __call__(self, env: NbvEnv, record: StepRecord) -> None:
        from PIL import Image, ImageDraw

        if self._painter is None or not self.frames:
            self._painter = self._new_painter(env)
        self._coverage.append(record.metrics["coverage"])
        self._way.append(np.asarray(record.viewpoint))
        frame = Image.new("RGB", SIZE, PAPER)
        frame.paste(self._painter.paint(env.belief.octree), (MARGIN, HEAD))
        # Lines and letters are drawn larger and scaled down, for smooth edges.
        layer = Image.new("RGBA", (SIZE[0] * FINE, SIZE[1] * FINE), (255, 255, 255, 0))
        pen = Pen(ImageDraw.Draw(layer))
        self._draw_box(pen)
        self._draw_way(pen, env)
        self._draw_column(frame, pen, env, record)
        smooth = layer.resize(SIZE, Image.Resampling.LANCZOS)
        frame.paste(smooth, (0, 0), smooth)
        self.frames.append(frame)

    def _new_painter(self, env: NbvEnv) -> VoxelPainter:
        floor = env.simulator.scene(0).floor
        ceiling = None if self.ceiling is None else floor + self.ceiling
        size = (SIZE[0] - COLUMN - 3 * MARGIN, SIZE[1] - HEAD - MARGIN)
        return VoxelPainter(region_of(env), env.belief.resolution, size, ceiling)

    def _pixels(self, points: NDArray[Any]) -> list[tuple[float, float]]:
        assert self._painter is not None
        return [(x + MARGIN, y + HEAD) for x, y in self._painter.project(np.asarray(points).reshape(-1, 3)).tolist()]

    def _draw_box(self, pen: Pen) -> None:
        """The floor of what is shown."""
        assert self._painter is not None
        (x0, y0, z0), (x1, y1, _) = self._painter.box
        corners = self._pixels(np.array([[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0], [x0, y0, z0]]))
        pen.line(corners, fill=(208, 213, 219), width=1)

    def _draw_way(self, pen: Pen, env: NbvEnv) -> None:
        way = np.array(self._way)
        pixels = self._pixels(way[:, :3])
        if len(pixels) > 1:
            pen.line(pixels, fill=(255, 255, 255), width=4)
            pen.line(pixels, fill=WAY_COLOUR, width=2)
        for x, y in pixels[:-1]:
            pen.disc(x, y, 3.0, WAY_COLOUR, PAPER)
        apex, *corners = self._pixels(camera_pyramid(env, way[-1]))
        for width, colour in ((4, (255, 255, 255)), (2, CAMERA_COLOUR)):
            pen.line([*corners, corners[0]], fill=colour, width=width)
            for corner in corners:
                pen.line([apex, corner], fill=colour, width=width)

    def _draw_column(self, frame: Image, pen: Pen, env: NbvEnv, record: StepRecord) -> None:
        from PIL import Image

        left, right = SIZE[0] - MARGIN - COLUMN, SIZE[0] - MARGIN
        pen.text((MARGIN, 18), self.title, fill=INK, size=17, bold=True)
        pen.text((right, 22), f"view {len(self._way)}", fill=INK, size=14, bold=True, anchor="ra")
        depth = env.simulator.scene(0).render_depth(*fine_camera(env, record.viewpoint, COLUMN))
        picture = Image.fromarray(depth_image(np.asarray(depth), env.belief.camera.far))
        frame.paste(picture, (left, 62))
        y = 62 + picture.height + 6
        pen.text((left, y), f"depth image, 0 – {env.belief.camera.far:g} m", fill=FAINT, size=11)
        y += 34
        metrics = record.metrics
        for name, value in (
            ("coverage", f"{metrics['coverage'] * 100:.1f} %"),
            ("information Σ(1−u)", f"{metrics['information']:,.0f}"),
            ("entropy of the map", f"{metrics['entropy'] / 1000:,.1f} kbit"),
            ("path", f"{metrics['path_length']:.1f} m"),
        ):
            pen.text((left, y), name, fill=FAINT, size=12)
            pen.text((right, y), value, fill=INK, size=13, bold=True, anchor="ra")
            y += 22
        self._draw_curve(pen, (left, y + 22, right, SIZE[1] - MARGIN - 62), env.task.budget + 1)
        bar = uncertainty_colours(np.linspace(1.0, 0.0, COLUMN))
        strip = np.repeat((bar * 255).astype(np.uint8)[None], 9, axis=0)
        frame.paste(Image.fromarray(strip), (left, SIZE[1] - MARGIN - 28))
        pen.text((left, SIZE[1] - MARGIN - 15), "uncertain, u = 1", fill=FAINT, size=11)
        pen.text((right, SIZE[1] - MARGIN - 15), "certain, u = 0", fill=FAINT, size=11, anchor="ra")

    def _draw_curve(self, pen: Pen, box: tuple[int, int, int, int], views: int) -> None:
        x0, y0, x1, y1 = box
        for share in (0.0, 0.5, 1.0):
            y = y1 - share * (y1 - y0)
            pen.line([(x0 + 34, y), (x1, y)], fill=(222, 226, 230))
            pen.text((x0 + 28, y), f"{share * 100:.0f} %", fill=FAINT, size=10, anchor="rm")
        step = (x1 - x0 - 40) / max(views - 1, 1)
        points = [(x0 + 34 + i * step, y1 - c * (y1 - y0)) for i, c in enumerate(self._coverage)]
        if len(points) > 1:
            pen.line(points, fill=COLOURS["greedy"], width=2.5)
        x, y = points[-1]
        pen.disc(x, y, 4.5, COLOURS["greedy"], PAPER)

    def save(self, path: Path) -> None:
        """Write the GIF; the last frame stands for three seconds."""
        if not self.frames:
            raise ValueError("a film needs at least one frame")
        from PIL import Image

        # One palette for all frames (no flicker, small differences), from a sheet that shows each frame's picture
        # once and the maps of a few.
        shown = [self.frames[i] for i in np.unique(np.linspace(0, len(self.frames) - 1, MAPS_IN_PALETTE).astype(int))]
        tiles = [f.crop((SIZE[0] - MARGIN - COLUMN, HEAD, SIZE[0] - MARGIN, HEAD + 200)) for f in self.frames]
        sheet = Image.new("RGB", (SIZE[0], SIZE[1] * len(shown) + 200 * -(-len(tiles) // 3)), PAPER)
        for row, frame in enumerate(shown):
            sheet.paste(frame, (0, row * SIZE[1]))
        for number, tile in enumerate(tiles):
            sheet.paste(tile, (number % 3 * COLUMN, len(shown) * SIZE[1] + number // 3 * 200))
        palette = sheet.quantize(255, method=Image.Quantize.MEDIANCUT, kmeans=1)
        flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in self.frames]
        durations = [FRAME_MS] * (len(flat) - 1) + [LAST_MS]
        path.parent.mkdir(parents=True, exist_ok=True)
        flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0, optimize=False, disposal=1)


def film_title(agent: str, place: str) -> str:
    return f"{label(agent)} in {place}"


def font(size: int, bold: bool = False) -> Any:
    """DejaVu Sans, which matplotlib brings along."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / name), size)


def fine_camera(env: NbvEnv, viewpoint: NDArray[Any], width: int) -> tuple[Any, NDArray[np.float32]]:
    """The task's camera with more pixels, for pictures, and the viewpoint: arguments of `Scene.render_depth`."""
    from ..rust_env import Camera

    camera = env.belief.camera
    height = max(1, round(width * camera.height / camera.width))
    fine = Camera(width, height, camera.hfov, vfov=camera.vfov, near=camera.near, far=camera.far, kind=camera.kind)
    return fine, np.asarray(viewpoint, dtype=np.float32)


def depth_image(depth: NDArray[np.floating], far: float) -> NDArray[np.uint8]:
    """A depth image in colour (height, width, 3)."""
    measured = np.isfinite(depth) & (depth > 0) & (depth <= far)
    rgba = depth_colormap()(np.ma.masked_where(~measured, np.where(measured, depth, 0) / far))
    return (rgba[..., :3] * 255).astype(np.uint8)


def camera_pyramid(env: NbvEnv, viewpoint: NDArray[np.floating]) -> NDArray[np.float64]:
    """Apex and the four corners of the image at `PYRAMID` metres depth, in the world, (5, 3)."""
    camera = env.belief.camera
    u, v = np.array([0, camera.width, camera.width, 0]), np.array([0, 0, camera.height, camera.height])
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(4)], axis=1) * PYRAMID
    x, y, z, w = np.asarray(viewpoint[3:], dtype=np.float64)
    axis = np.array([x, y, z])
    # Rotation by a quaternion: v + 2 w (a x v) + 2 a x (a x v).
    turned = rays + 2 * w * np.cross(axis, rays) + 2 * np.cross(axis, np.cross(axis, rays))
    return np.asarray(viewpoint[:3], dtype=np.float64) + np.vstack([np.zeros(3), turned])
