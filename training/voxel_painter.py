"""Draws a voxel map from obliquely above, in NumPy: a few hundredths of a second for a room.

A parallel projection whose voxel steps are whole pixels: each visible face is the same small parallelogram of pixels,
so that a picture is one sorted assignment (far faces first) and neighbouring faces meet without a gap. The viewer
stands at -x, -y above the scene and sees the faces towards -x, -y and +z.

A face is drawn only where it borders *known free* space. Walls between the viewer and a room border unknown space on
their outer side, so they vanish by themselves and the room lies open, as in a doll's house.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image

    from ..rust_env import Octree

#: What is at points (n, 3): -1 unknown, 0 free, 1 occupied, (n,).
Classify: TypeAlias = Callable[[NDArray[np.float32]], NDArray[np.int8]]

#: Pixels per voxel step: right and up for x and y, up for z. 3 : 2 : 3 looks down at 42 degrees.
SHAPE = (3, 2, 3)
#: Outward normal of each drawn face, the two directions within it, and how much light it gets.
FACES = (
    ((-1, 0, 0), (0, 1, 0), (0, 0, 1), 0.90),
    ((0, -1, 0), (1, 0, 0), (0, 0, 1), 0.78),
    ((0, 0, 1), (1, 0, 0), (0, 1, 0), 1.00),
)
#: Darkening of a face's cell by eight occupied neighbours, and of the seam between voxels.
OCCLUSION, SEAM = 0.55, 0.90
PAPER = (255, 255, 255)
#: Uncertainty 1 -> 0 as red -> yellow -> green (after Lluvia et al. 2023, Fig. 5), softened for print.
UNCERTAINTY_COLOURS = ((0.84, 0.19, 0.15), (0.96, 0.56, 0.28), (0.98, 0.85, 0.42), (0.60, 0.80, 0.36), (0.14, 0.60, 0.29))
#: Largest side of a picture before it is scaled down, pixels.
MAX_CANVAS = 6000


def uncertainty_colours(uncertainty: NDArray[np.floating]) -> NDArray[np.float64]:
    """RGB in 0..1, shape (n, 3): red for u = 1 over yellow to green for u = 0."""
    stops = np.linspace(1.0, 0.0, len(UNCERTAINTY_COLOURS))[::-1]
    table = np.array(UNCERTAINTY_COLOURS)[::-1]
    u = np.clip(np.asarray(uncertainty, dtype=np.float64), 0.0, 1.0)
    return np.stack([np.interp(u, stops, table[:, c]) for c in range(3)], axis=-1)


class VoxelPainter:
    """Pictures of maps within the same bounds, so that the frames of an animation agree.

    Args:
        bounds: (2, 3) lower and upper corner of what is shown, metres.
        resolution: side of a voxel, metres.
        size: width and height of the picture, pixels.
        ceiling: leave out voxels above this height, metres.
    """

    def __init__(self, bounds: NDArray[np.floating], resolution: float, size: tuple[int, int], ceiling: float | None = None) -> None:
        self.resolution = float(resolution)
        self.size = size
        low, high = np.asarray(bounds, dtype=np.float64)
        if ceiling is not None:
            high = np.array([high[0], high[1], max(min(high[2], ceiling), low[2] + self.resolution)])
        self.first = np.floor(low / self.resolution).astype(np.int64)
        self.last = np.ceil(high / self.resolution).astype(np.int64)
        self.box = np.stack([low, high])
        extent = np.maximum(self.last - self.first, 1)
        wide, tall = self._extent(extent, 1)
        # Draw at two to three times the final size for smooth edges, as memory allows.
        fit = min(size[0] / wide, size[1] / tall)
        self.unit = int(np.clip(np.ceil(2.0 * fit), 1, max(1, MAX_CANVAS // max(wide, tall))))
        a, b, c = (self.unit * s for s in SHAPE)
        self.steps = np.array([[a, -b], [-a, -b], [0, -c]], dtype=np.int64)
        self.canvas = self._extent(extent, self.unit)
        self.origin = np.array([a * extent[1], self.canvas[1]], dtype=np.int64)
        self.scale = min(size[0] / self.canvas[0], size[1] / self.canvas[1])
        self.offset = (np.array(size) - self.scale * np.array(self.canvas)) / 2
        self.sprites = self._sprites()

    @staticmethod
    def _extent(extent: NDArray[np.int64], unit: int) -> tuple[int, int]:
        a, b, c = (unit * s for s in SHAPE)
        return int(a * (extent[0] + extent[1])), int(b * (extent[0] + extent[1]) + c * extent[2])

    def _sprites(self) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Per face: pixel offsets from the voxel's lower corner (m, 2) and their shade (m,), m the same for all."""
        found = []
        for normal, first, second, light in FACES:
            u, v = (np.array(d) @ self.steps for d in (first, second))
            corner = np.array([0, 0, max(normal[2], 0)]) @ self.steps
            hull = corner + np.array([[0, 0], u, v, u + v])
            low, high = hull.min(axis=0), hull.max(axis=0)
            x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
            pixels = np.stack([x.ravel(), y.ravel()], axis=1)
            s, t = np.linalg.solve(np.stack([u, v], axis=1), (pixels + 0.5 - corner).T)
            inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1)
            edge = (np.minimum(s, t)[inside] < 0.5 / self.unit / 2) & (self.unit >= 3)
            found.append((pixels[inside], light * np.where(edge, SEAM, 1.0)))
        longest = max(len(p) for p, _ in found)
        return [(np.resize(p, (longest, 2)), np.resize(s, longest)) for p, s in found]

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Pixels (n, 2) of world points (n, 3) in the finished picture."""
        steps = np.asarray(points, dtype=np.float64) / self.resolution - self.first
        return (steps @ self.steps + self.origin) * self.scale + self.offset

    def paint(self, octree: Octree) -> Image:
        """The map's occupied voxels, coloured by their uncertainty."""
        uncertainty = np.asarray(octree.occupied_uncertainty())
        return self.paint_voxels(octree.occupied(), uncertainty_colours(uncertainty), octree.classify)

    def paint_voxels(self, centers: NDArray[np.floating], colours: NDArray[np.float64], classify: Classify) -> Image:
        """Voxels (n, 3), metres, in their colours (n, 3), 0..1; `classify` says what their neighbours are."""
        from PIL import Image

        keys = np.floor(np.asarray(centers) / self.resolution).astype(np.int64).reshape(-1, 3)
        inside = ((keys >= self.first) & (keys < self.last)).all(axis=1)
        canvas = np.empty((self.canvas[1] + 1, self.canvas[0] + 1, 3), dtype=np.uint8)
        canvas[:] = PAPER
        if inside.any():
            self._draw(canvas, keys[inside], colours[inside], classify)
        small = (max(1, round(self.canvas[0] * self.scale)), max(1, round(self.canvas[1] * self.scale)))
        picture = Image.new("RGB", self.size, PAPER)
        scaled = Image.fromarray(canvas[:-1, :-1]).resize(small, Image.Resampling.LANCZOS)
        picture.paste(scaled, (round(self.offset[0]), round(self.offset[1])))
        return picture

    def _states(self, classify: Classify, keys: NDArray[np.int64]) -> NDArray[np.int8]:
        return np.asarray(classify(((keys + 0.5) * self.resolution).astype(np.float32)))

    def _draw(self, canvas: NDArray[np.uint8], keys: NDArray[np.int64], colours: NDArray[np.float64], classify: Classify) -> None:
        parts = []
        for (normal, first, second, _), (offsets, shades) in zip(FACES, self.sprites, strict=True):
            before = keys + np.array(normal)
            faces = np.flatnonzero(self._states(classify, before) == 0)
            around = [i * np.array(first) + j * np.array(second) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
            crowd = np.zeros(len(faces))
            for step in around:
                crowd += self._states(classify, before[faces] + step) == 1
            light = 1.0 - OCCLUSION * (crowd / 8.0)
            corners = (keys[faces] - self.first) @ self.steps + self.origin
            depth = keys[faces] @ np.array([-1, -1, 1])
            parts.append((depth, corners, colours[faces] * light[:, None], offsets, shades))
        depths = np.concatenate([p[0] for p in parts])
        width = canvas.shape[1]
        pixels = np.concatenate([(p[1][:, None, 1] + p[3][:, 1]) * width + p[1][:, None, 0] + p[3][:, 0] for p in parts])
        order = np.argsort(depths, kind="stable")
        inks = np.concatenate([(p[2][:, None, :] * p[4][:, None] * 255.0).astype(np.uint8) for p in parts])
        # Of several values for one pixel NumPy keeps the last: the nearest face.
        canvas.reshape(-1, 3)[pixels[order].ravel()] = inks[order].reshape(-1, 3)
