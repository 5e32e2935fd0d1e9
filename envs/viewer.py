"""One frame of an episode, drawn with NumPy and Pillow: the depth image, the map from above, the metrics.

It shows what the robot knows; of the truth only the coverage, as a number.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..rust_env import Belief

WIDTH, HEIGHT = 800, 480
MARGIN, TITLE = 16, 22
#: Left, top, width, height in pixels.
DEPTH_PANEL = (MARGIN, MARGIN + TITLE, 320, 240)
MAP_PANEL = (DEPTH_PANEL[0] + DEPTH_PANEL[2] + MARGIN, MARGIN + TITLE, 432, HEIGHT - 2 * MARGIN - TITLE)
TEXT_TOP = DEPTH_PANEL[1] + DEPTH_PANEL[3] + MARGIN

BACKGROUND = (18, 22, 30)
PANEL = (27, 32, 43)
TEXT = (226, 230, 238)
FAINT = (134, 144, 162)
TRACK = (255, 196, 61)
CAMERA = (255, 94, 91)
BAR = (61, 201, 176)
#: Colours of the map's cells: unknown, free; occupied from the lowest to the highest voxel of the column.
CELLS = np.array([(44, 51, 66), (214, 220, 230), (0, 0, 0)], np.uint8)
HEIGHTS = np.array([(24, 54, 110), (48, 104, 196), (118, 178, 242)], np.float32)
#: Near to far, after the colour map "inferno"; beyond the last, where nothing was measured, comes the panel's colour.
DEPTHS = np.array([(252, 255, 164), (251, 155, 6), (207, 68, 70), (120, 28, 109), (40, 11, 84)], np.float32)
#: Share of the height that is left out of the map at the floor and at the ceiling.
TRIM = 0.15


def draw(belief: Belief, depth: NDArray[np.float32], metrics: Mapping[str, float], budget: int) -> NDArray[np.uint8]:
    """A frame.

    Args:
        belief: What the robot knows.
        depth: (height, width) the last image, metres.
        metrics: One value of each of :data:`nbv_gym.rust_env.METRICS`.
        budget: Steps of an episode.

    Returns:
        (480, 800, 3) uint8 RGB.
    """
    frame = Image.new("RGB", (WIDTH, HEIGHT), BACKGROUND)
    pen = ImageDraw.Draw(frame)
    camera = belief.camera

    left, _, width, _ = DEPTH_PANEL
    pen.text((left, MARGIN - 2), "depth", TEXT, font=font(14))
    pen.text((left + width, MARGIN), f"0 to {camera.far:g} m", FAINT, font=font(12), anchor="ra")
    paste(frame, colour_depth(depth, camera.far), DEPTH_PANEL, Image.Resampling.NEAREST)

    draw_map(frame, pen, belief)
    draw_metrics(pen, belief, metrics, budget)
    return np.asarray(frame).copy()


def colour_depth(depth: NDArray[np.float32], far: float) -> NDArray[np.uint8]:
    """(height, width, 3) uint8: near is bright; nothing measured is the panel's colour."""
    measured = (depth > 0) & (depth < far)
    colours = blend(DEPTHS, np.where(measured, depth, 0) / far)
    return np.where(measured[..., np.newaxis], colours, PANEL).astype(np.uint8)


def blend(colours: NDArray[np.float32], place: NDArray[np.floating]) -> NDArray[np.float32]:
    """Colours (..., 3) at places in [0, 1] along a row of colours."""
    scaled = place * (len(colours) - 1)
    index = np.minimum(scaled.astype(np.intp), len(colours) - 2)
    weight = (scaled - index)[..., np.newaxis]
    return (colours[index] * (1 - weight) + colours[index + 1] * weight).astype(np.float32)


def colour_map(
    grid: NDArray[np.int8], origin: tuple[float, float], voxels: NDArray[np.float32], resolution: float, z: tuple[float, float]
) -> NDArray[np.uint8]:
    """(rows, columns, 3) uint8, row 0 at the smallest y.

    Args:
        grid: (rows, columns) -1 unknown, 0 free, 1 occupied.
        origin: x and y of its lower-left corner, metres.
        voxels: (n, 3) centres of the occupied voxels, metres.
        resolution: Side of a cell, metres.
        z: From which to which height, metres.
    """
    tops = np.full(grid.shape, z[0])
    columns, rows = (np.floor((voxels[:, axis] - origin[axis]) / resolution).astype(np.intp) for axis in (0, 1))
    inside = (rows >= 0) & (rows < grid.shape[0]) & (columns >= 0) & (columns < grid.shape[1])
    inside &= (voxels[:, 2] >= z[0]) & (voxels[:, 2] <= z[1])
    np.maximum.at(tops, (rows[inside], columns[inside]), voxels[inside, 2])
    heights = blend(HEIGHTS, (tops - z[0]) / max(z[1] - z[0], 1e-6))
    return np.where((grid == 1)[..., np.newaxis], heights, CELLS[grid + 1]).astype(np.uint8)


def draw_map(frame: Image.Image, pen: ImageDraw.ImageDraw, belief: Belief) -> None:
    """The map between the heights that matter, higher things lighter, the way so far, the camera."""
    low, high = belief.bounds
    trim = TRIM * (high[2] - low[2])
    z_min, z_max = float(low[2] + trim), float(high[2] - trim)
    grid, origin = belief.slice(z_min, z_max)
    left, _, width, _ = MAP_PANEL
    pen.text((left, MARGIN - 2), "map from above", TEXT, font=font(14))
    pen.text((left + width, MARGIN), f"{z_min:.2f} to {z_max:.2f} m", FAINT, font=font(12), anchor="ra")
    cells = colour_map(grid, origin, belief.octree.occupied(), belief.resolution, (z_min, z_max))
    x0, y0, scale = paste(frame, cells[::-1], MAP_PANEL, Image.Resampling.NEAREST)
    rows = grid.shape[0]

    def pixel(x: float, y: float) -> tuple[float, float]:
        column, row = (x - origin[0]) / belief.resolution, (y - origin[1]) / belief.resolution
        return x0 + column * scale, y0 + (rows - row) * scale

    way = [pixel(x, y) for x, y in belief.trajectory[:, :2]]
    if len(way) > 1:
        pen.line(way, TRACK, width=2, joint="curve")
    for x, y in way:
        pen.ellipse((x - 2, y - 2, x + 2, y + 2), TRACK)

    pose = belief.pose
    yaw = heading(pose[3:])
    half, reach = belief.camera.hfov / 2, 34
    x, y = pixel(pose[0], pose[1])
    edges = [(x + reach * np.cos(a), y - reach * np.sin(a)) for a in (yaw - half, yaw + half)]
    pen.polygon([(x, y), *edges], outline=CAMERA)
    pen.ellipse((x - 5, y - 5, x + 5, y + 5), CAMERA, outline=BACKGROUND)


def draw_metrics(pen: ImageDraw.ImageDraw, belief: Belief, metrics: Mapping[str, float], budget: int) -> None:
    left, width = DEPTH_PANEL[0], DEPTH_PANEL[2]
    x, y, z = belief.pose[:3]
    coverage = metrics["coverage"]
    bar = TEXT_TOP + 18
    pen.text((left, TEXT_TOP - 4), "coverage", TEXT, font=font(14))
    pen.text((left + width, TEXT_TOP - 4), f"{coverage:.1%}", TEXT, font=font(14), anchor="ra")
    pen.rounded_rectangle((left, bar, left + width, bar + 8), 4, PANEL)
    if coverage > 0.02:
        pen.rounded_rectangle((left, bar, left + width * min(coverage, 1.0), bar + 8), 4, BAR)
    lines = [
        ("step", f"{metrics['views'] - 1:.0f} of {budget}"),
        ("gain of this view", f"{metrics['information_gain_bits']:,.0f} bits"),
        ("new surface voxels", f"{metrics['new_surface_voxels']:+,.0f}"),
        ("known voxels", f"{metrics['known_voxels']:,.0f}"),
        ("path", f"{metrics['path_length']:.2f} m" + ("   contact" if metrics["contact"] else "")),
        ("camera", f"{x:.2f}  {y:.2f}  {z:.2f} m   {np.degrees(heading(belief.pose[3:])):.0f}°"),
    ]
    for i, (name, value) in enumerate(lines):
        line = bar + 20 + 19 * i
        pen.text((left, line), name, FAINT, font=font(13))
        pen.text((left + width, line), value, TEXT, font=font(13), anchor="ra")


def heading(quaternion: NDArray[np.float32]) -> float:
    """Yaw of the optical axis (camera z) in the world's xy plane, radians."""
    x, y, z, w = (float(v) for v in quaternion)
    return float(np.arctan2(2 * (y * z - w * x), 2 * (x * z + w * y)))


def paste(
    frame: Image.Image, pixels: NDArray[np.uint8], panel: tuple[int, int, int, int], resample: Image.Resampling
) -> tuple[float, float, float]:
    """Fit an image into a panel, centred, in its own proportions. Returns its left, top and pixels per cell."""
    left, top, width, height = panel
    ImageDraw.Draw(frame).rectangle((left, top, left + width - 1, top + height - 1), PANEL)
    rows, columns = pixels.shape[:2]
    scale = min(width / columns, height / rows)
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    x, y = left + (width - size[0]) // 2, top + (height - size[1]) // 2
    frame.paste(Image.fromarray(pixels).resize(size, resample), (x, y))
    return x, y, scale


@lru_cache
def font(size: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)
