"""Triangles to files that every mesh viewer reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def write_mesh(path: Path, triangles: NDArray[np.float32]) -> None:
    """Write triangles (m, 3, 3), metres, as binary PLY or as OBJ, by the suffix; equal corners become one vertex."""
    corners = np.asarray(triangles, dtype="<f4").reshape(-1, 3)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    suffix = path.suffix.lower()
    if suffix not in {".ply", ".obj"}:
        raise ValueError(f"cannot write {path}: the suffix must be .ply or .obj")
    path.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".ply":
        header = (
            "ply\nformat binary_little_endian 1.0\ncomment nbv-gym, metres, z up\n"
            f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        )
        rows = np.empty(len(faces), dtype=[("count", "u1"), ("index", "<i4", 3)])
        rows["count"], rows["index"] = 3, faces
        path.write_bytes(header.encode("ascii") + vertices.astype("<f4").tobytes() + rows.tobytes())
        return
    lines = ["# nbv-gym, metres, z up"]
    lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
