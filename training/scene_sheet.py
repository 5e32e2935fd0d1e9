"""A contact sheet of generated scenes: each kind from above with several seeds, and one view from the inside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .film import font
from .plans import scene_image
from .view_command import level

if TYPE_CHECKING:
    from ..rust_env import Scene

#: Side of a picture, and the space around it, pixels.
SIDE, GAP, HEAD = 216, 8, 18
#: Height at which plans are cut; the top of a table that stands in a room is seen from above it.
CUT = 1.6
PAPER, INK = (255, 255, 255), (60, 66, 74)
#: Of the inside view, radians.
PITCH = -0.25
#: Where the light of the inside view comes from, in the camera frame (x right, y down, z forward).
LIGHT = np.array([-0.35, -0.75, -0.55]) / np.linalg.norm([-0.35, -0.75, -0.55])


def save_scene_sheet(path: Path, kinds: Sequence[str], seeds: Sequence[int]) -> None:
    """One row a kind: a top view of each seed, then what a camera at the first scene's first start sees. The ending of
    `path` decides the format (.png, .jpg)."""
    from PIL import Image, ImageDraw

    from ..rust_env import Scene

    columns = len(seeds) + 1
    sheet = Image.new("RGB", (columns * (SIDE + GAP) + GAP, len(kinds) * (SIDE + GAP + HEAD) + GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    for row, kind in enumerate(kinds):
        y = GAP + row * (SIDE + GAP + HEAD)
        scenes = [Scene.generate(kind, seed) for seed in seeds]
        pictures = [top_view(scene) for scene in scenes] + [inside_view(scenes[0])]
        captions = [caption(scene) for scene in scenes] + [f"{kind}:{seeds[0]} from inside"]
        for column, (picture, text) in enumerate(zip(pictures, captions, strict=True)):
            x = GAP + column * (SIDE + GAP)
            draw.text((x, y), text, fill=INK, font=font(11))
            image = Image.fromarray((np.clip(picture, 0, 1) * 255).astype(np.uint8))
            corner = (x + (SIDE - image.width) // 2, y + HEAD + (SIDE - image.height) // 2)
            sheet.paste(image, corner)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, **({"quality": 84, "optimize": True} if path.suffix.lower() in {".jpg", ".jpeg"} else {"optimize": True}))


def caption(scene: Scene) -> str:
    low, high = scene.bounds
    across, along, _ = high - low
    return f"{scene.name}  {across:.1f} × {along:.1f} m"


def top_view(scene: Scene) -> NDArray[np.float64]:
    """(rows, columns, 3) in 0..1, the first row at the highest y."""
    bounds = scene.bounds.copy()
    cut = min(scene.floor + CUT, float(bounds[1, 2]) + 0.3)
    return scene_image(scene, bounds, cut, SIDE)[::-1]


def inside_view(scene: Scene) -> NDArray[np.float64]:
    """(SIDE, SIDE, 3) in 0..1: surfaces lit from the upper left, darker with their distance."""
    from ..rust_env import Camera

    camera = Camera(SIDE, SIDE, np.deg2rad(80), far=15.0)
    x, y, z, yaw = scene.starts[0]
    # A little down: turned about the camera's x axis.
    qx, qy, qz, qw = level(float(yaw))
    c, s = np.cos(PITCH / 2), np.sin(PITCH / 2)
    turned = (qx * c + qw * s, qy * c + qz * s, qz * c - qy * s, qw * c - qx * s)
    pose = np.array([x, y, z, *turned], np.float32)
    depth = np.asarray(scene.render_depth(camera, pose), dtype=np.float64)
    u, v = np.meshgrid((np.arange(SIDE) + 0.5) / SIDE * 2 - 1, (np.arange(SIDE) + 0.5) / SIDE * 2 - 1)
    rays = np.stack([u * np.tan(np.deg2rad(40)), v * np.tan(np.deg2rad(40)), np.ones_like(u)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    seen = np.isfinite(depth) & (depth > 0)
    points = rays * np.where(seen, depth, camera.far)[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    normal *= -np.sign(np.sum(normal * rays, axis=-1, keepdims=True))
    # Half-Lambert: what faces away from the light is not black.
    light = 0.32 + 0.34 * (1.0 + normal @ LIGHT)
    tone = (light * np.exp(-np.where(seen, depth, 0.0) / 14.0))[..., None]
    image = tone * np.array([0.97, 0.955, 0.93])
    image[~seen] = (0.80, 0.86, 0.92)
    return np.asarray(image)
