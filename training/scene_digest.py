"""A scene file as a digest: results and data sets of a scene that has changed since are not taken for those of today's."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from ..rust_env import Scene


def scene_digest(path: str | Path) -> str:
    """SHA-256 of a scene file and of what it and all files that it refers to make up: triangles, objects, bounds, actors.

    A world's text may stay the same while a mesh, or a model that it includes, becomes another. Materials do not count, since a
    depth image does not depend on them.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is malformed; the message names file and element.
    """
    scene = Scene.load(path)
    digest = hashlib.sha256(Path(path).read_bytes())
    for name in ("triangles", "collision_triangles", "objects", "bounds"):
        value = np.ascontiguousarray(getattr(scene, name))
        digest.update(f" {name} {value.dtype.str} {value.shape} ".encode())
        digest.update(value.data)
    digest.update(json.dumps([scene.floor, scene.actors]).encode())
    return digest.hexdigest()
