"""`nbv-gym view`: pictures of a scene, and an episode played again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from ..agents import StepRecord
from . import figures
from .demo import CEILING
from .evaluate import Observer, open_env
from .film import Film, depth_image, film_title
from .manifest import Row
from .recording import Recording
from .scene_commands import open_scene
from .terminal import bar
from .voxel_painter import VoxelPainter

if TYPE_CHECKING:
    from ..rust_env import Scene

#: Most voxels of a picture of a scene; a larger scene is drawn in coarser ones.
MAX_VOXELS = 1_500_000
#: What a voxel's height looks like, from the floor to the top.
HEIGHT_COLOURS = ((0.86, 0.82, 0.75), (0.62, 0.70, 0.74), (0.36, 0.49, 0.60), (0.24, 0.34, 0.47))


def view_command(source: str, out: Path | None, episode: int, resolution: float, console: Console) -> None:
    """Draw a scene, or replay an episode of a results file."""
    if source.endswith(".json"):
        replay(Path(source), episode, out or Path("out/view/episode.gif"), console)
        return
    target = out or Path("out/view/scene.png")
    if target.suffix.lower() != ".png":
        raise ValueError(f"a scene is drawn to a .png file, not to {target}")
    save_scene(open_scene(source), target, resolution)
    console.print(f"  {target}", highlight=False)


def replay(path: Path, episode: int, out: Path, console: Console) -> None:
    """Run an episode again from its recorded actions, and film or record it."""
    content = json.loads(path.read_text(encoding="utf-8"))
    episodes = content.get("episodes") if isinstance(content, dict) else None
    if not isinstance(episodes, list) or not episodes:
        raise ValueError(f"{path} holds no episodes; it must be a results file of evaluate or demo")
    if episode >= len(episodes):
        raise ValueError(f"{path} has episodes 0 to {len(episodes) - 1}, there is no {episode}")
    record = episodes[episode]
    if record["status"] != "ok":
        raise ValueError(f"episode {episode} of {path} failed: {record['error']}")
    row = Row(**record["row"])
    place = Path(row.scene).stem if row.scene else row.task.replace("_", " ")
    watcher: Film | Recording
    if out.suffix == ".rrd":
        watcher = Recording(out)
    elif out.suffix == ".gif":
        watcher = Film(film_title(row.agent, place), None if row.scene is None else CEILING)
    else:
        raise ValueError(f"an episode is written to a .gif or .rrd file, not to {out}")
    play(row, record["actions"], watcher, console)
    if isinstance(watcher, Film):
        watcher.save(out)
    else:
        watcher.close()
    console.print(f"  {row.agent}, seed {row.seed}: {out}", highlight=False)


def play(row: Row, actions: list[Any], watch: Observer, console: Console) -> None:
    from ..rust_env import METRICS

    env = open_env(row)
    with bar(console) as progress:
        work = progress.add_task("Playing", total=len(actions) + 1)
        _, info = env.reset(seed=row.seed)
        watch(env, StepRecord(env.belief.pose, {name: float(info[name]) for name in METRICS}))
        progress.advance(work)
        for action in actions:
            _, reward, terminated, truncated, info = env.step(np.asarray(action))
            metrics = {name: float(info[name]) for name in METRICS}
            watch(env, StepRecord(env.belief.pose, metrics, action, reward, 0.0, terminated, truncated))
            progress.advance(work)
    env.close()


class _Surface:
    """A scene's surface voxels, asked like a map in which everything else is free."""

    def __init__(self, centers: NDArray[np.float32], resolution: float) -> None:
        self.resolution = resolution
        keys = np.floor(centers / resolution).astype(np.int64)
        self.low, self.high = keys.min(axis=0) - 2, keys.max(axis=0) + 3
        self.grid = np.zeros(self.high - self.low, dtype=np.int8)
        self.grid[tuple((keys - self.low).T)] = 1

    def classify(self, points: NDArray[np.float32]) -> NDArray[np.int8]:
        keys = np.clip(np.floor(points / self.resolution).astype(np.int64), self.low, self.high - 1) - self.low
        states: NDArray[np.int8] = self.grid[tuple(keys.T)]
        return states


def save_scene(scene: Scene, path: Path, resolution: float) -> None:
    """One picture: oblique view cut below ceilings, and depth images from up to three start positions."""
    centers = np.asarray(scene.surface_voxels(resolution))
    while len(centers) > MAX_VOXELS:
        resolution *= 2
        centers = np.asarray(scene.surface_voxels(resolution))
    if not len(centers):
        raise ValueError("the scene has no surface to draw")
    cut = scene.floor + CEILING
    below = centers[centers[:, 2] < cut]
    centers = below if len(below) else centers
    bounds = np.stack([centers.min(axis=0), centers.max(axis=0)]) + np.array([[-resolution], [resolution]])
    share = (centers[:, 2] - bounds[0, 2]) / max(float(np.ptp(bounds[:, 2])), 1e-6)
    stops = np.linspace(0, 1, len(HEIGHT_COLOURS))
    colours = np.stack([np.interp(share, stops, np.array(HEIGHT_COLOURS)[:, c]) for c in range(3)], axis=1)
    painter = VoxelPainter(bounds, resolution, (1500, 1050))
    picture = painter.paint_voxels(centers, colours, _Surface(centers, resolution).classify)
    looks = first_looks(scene)
    size = np.ptp(np.asarray(scene.bounds), axis=0)
    with figures.canvas(11.4 if looks else 8.6, 6.6) as figure:
        subtitle = (
            f"{size[0]:.1f} × {size[1]:.1f} × {size[2]:.1f} m, {len(scene.triangles):,} triangles, drawn up to {CEILING} m above the floor"
        )
        top = figures.headline(figure, scene.name.replace("_", " "), subtitle)
        width = 0.74 if looks else 0.98
        axis = figure.add_axes((0.01, 0.02, width, 1 - top - 0.03))
        axis.imshow(picture)
        axis.set_axis_off()
        for number, look in enumerate(looks):
            side = figure.add_axes((0.765, 0.64 - 0.3 * number, 0.225, 0.265))
            side.imshow(look)
            side.set_axis_off()
            side.set_title(f"depth from start {number + 1}", fontsize=8.5, fontweight="normal", pad=3)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)


def first_looks(scene: Scene) -> list[NDArray[np.uint8]]:
    """Depth images, in colour, from up to three of the scene's start positions."""
    from ..rust_env import Camera

    camera = Camera(320, 240, hfov=np.deg2rad(75), far=8.0)
    looks = []
    for x, y, z, yaw in np.asarray(scene.starts)[:3]:
        pose = np.array([x, y, z, *level(yaw)], np.float32)
        looks.append(depth_image(np.asarray(scene.render_depth(camera, pose)), camera.far))
    return looks


def level(yaw: float) -> NDArray[np.float64]:
    """The quaternion (x, y, z, w) of a camera that looks along the heading `yaw`, level."""
    c, s = np.cos(yaw / 2), np.sin(yaw / 2)
    # (0, 0, s, c) times (-1/2, 1/2, -1/2, 1/2), the camera's axes for yaw 0.
    return 0.5 * np.array([-c - s, c - s, -c + s, c + s])
