"""The depth CNN that names the direction in which the next image will show most surface (Wang et al. 2019, section IV).

Two networks: AlexNet with one input channel and six outputs, as in the paper, and a small one for everyday use, whose weights
come with the package. torch is imported when a network is first needed (`pip install 'nbv-gym[train]'`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..rust_env import Camera

if TYPE_CHECKING:
    import torch
    from torch import nn

#: The six directions in the order of the network's outputs, and as unit vectors in the camera's frame (x right, y down,
#: z forward): Eq. 5's e^u, -e^u, e^f, -e^f, e^f x e^u and its opposite.
LABELS = ("up", "down", "forward", "backward", "right", "left")
DIRECTIONS: NDArray[np.float64] = np.array([[0, -1, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]], dtype=np.float64)
#: The output that a mirrored image has in the place of each output: right and left change places.
MIRRORED = (0, 1, 2, 3, 5, 4)

#: Version of the checkpoints' layout.
LAYOUT = 1
#: The weights that come with the package.
WEIGHTS = Path(__file__).parent / "weights" / "six_direction_small.pt"


class CheckpointError(ValueError):
    """A checkpoint that is damaged, of another layout, or for another network."""


def alexnet() -> nn.Module:
    """AlexNet (Krizhevsky 2012, in the one-tower form that is common today) with one input channel of 224 x 224 and six
    outputs; not pre-trained. 57 million parameters.

    As colours are for AlexNet, depths are centred and stretched first: the network has no normalisation of its own, and with
    depths in [0, 1] it learns next to nothing in its first epochs (docs/learning.md).
    """
    from torch import nn

    class Centred(nn.Module):
        def forward(self, unit: torch.Tensor) -> torch.Tensor:
            return (unit - 0.5) * 4.0

    return nn.Sequential(
        Centred(),
        nn.Conv2d(1, 64, 11, stride=4, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(), nn.MaxPool2d(3, 2),
        nn.Flatten(),
        nn.Dropout(0.5), nn.Linear(256 * 6 * 6, 4096), nn.ReLU(),
        nn.Dropout(0.5), nn.Linear(4096, 4096), nn.ReLU(),
        nn.Linear(4096, len(LABELS)),
    )  # fmt: skip


def small() -> nn.Module:
    """Five convolutions over 64 x 64 pixels; 0.6 million parameters. Where in the image something is matters for the
    direction, so that the last feature map is flattened, not averaged."""
    from torch import nn

    def stage(inputs: int, outputs: int, stride: int) -> list[nn.Module]:
        return [nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()]

    return nn.Sequential(
        nn.Conv2d(1, 32, 5, 2, 2, bias=False), nn.BatchNorm2d(32), nn.ReLU(),
        *stage(32, 64, 2), *stage(64, 96, 2), *stage(96, 128, 2), *stage(128, 128, 1),
        nn.Flatten(), nn.Dropout(0.3), nn.Linear(128 * 4 * 4, 128), nn.ReLU(), nn.Dropout(0.3), nn.Linear(128, len(LABELS)),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Architecture:
    """A network and the side of its square input image, pixels."""

    build: Callable[[], Any]
    size: int


ARCHITECTURES: dict[str, Architecture] = {
    "small": Architecture(small, 64),
    "alexnet": Architecture(alexnet, 224),
}


def architecture(name: str) -> Architecture:
    """Raises ValueError for a name that is none."""
    if name not in ARCHITECTURES:
        raise ValueError(f"there is no network {name!r}; known are {', '.join(ARCHITECTURES)}")
    return ARCHITECTURES[name]


def network_input(depth: torch.Tensor, far: float, size: int) -> torch.Tensor:
    """Depth images (n, h, w), metres, as a network sees them: (n, 1, size, size) in [0, 1].

    0 where nothing was measured because it is too near, 1 at `far` and beyond. The image is squeezed to a square.
    """
    import torch

    unit = torch.nan_to_num(depth.float(), nan=0.0, posinf=far, neginf=0.0).clamp(0.0, far) / far
    return torch.nn.functional.interpolate(unit[:, None], (size, size), mode="bilinear", align_corners=False, antialias=True)


def save_checkpoint(path: Path, name: str, network: nn.Module, far: float, facts: dict[str, Any]) -> None:
    """Write a checkpoint in one step: readers see the old or the new one. Weights are kept as float16 if `facts` say so.

    Raises:
        OSError: The file cannot be written; an older one is left as it was.
        ValueError: A weight is not finite, or beyond float16.
    """
    # On the CPU, wherever it was trained: others have no such device.
    state = {key: value.cpu() for key, value in network.state_dict().items()}
    if facts.get("half"):
        state = {key: value.half() if value.is_floating_point() else value for key, value in state.items()}
    if broken := [key for key, value in state.items() if not value.isfinite().all()]:
        raise ValueError(f"{path}: not written, since weights are not finite: {', '.join(broken)}")
    write_torch(path, {"layout": LAYOUT, "network": name, "labels": LABELS, "far": far, "facts": facts, "state": state})


def write_torch(path: Path, content: dict[str, Any]) -> None:
    """Write tensors and plain values in one step, as :func:`save_checkpoint`; they are on the disk when it returns."""
    import os

    import torch

    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with draft.open("wb") as file:
            torch.save(content, file)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def load_checkpoint(path: Path, expected: str | None = None) -> tuple[str, Any, float, dict[str, Any]]:
    """Network's name, network (in evaluation mode), range `far` in metres, facts about the training.

    Raises:
        OSError: There is no such file, or it cannot be read.
        CheckpointError: It is no checkpoint of ours, damaged, of another layout, or for another network than `expected`.
    """
    content = read_torch(path)
    if not isinstance(content, dict) or content.get("layout") != LAYOUT:
        found = content.get("layout") if isinstance(content, dict) else type(content).__name__
        raise CheckpointError(f"{path}: checkpoint layout {found!r}, this version reads {LAYOUT}")
    name = content.get("network")
    if name not in ARCHITECTURES:
        raise CheckpointError(f"{path}: for the network {name!r}; known are {', '.join(ARCHITECTURES)}")
    if expected is not None and name != expected:
        raise CheckpointError(f"{path}: for the network {name!r}, not {expected!r}")
    if tuple(content.get("labels", ())) != LABELS:
        raise CheckpointError(f"{path}: {len(content.get('labels', ()))} classes {content.get('labels')}, expected {LABELS}")
    network = ARCHITECTURES[name].build()
    try:
        network.load_state_dict(content["state"])
    except (RuntimeError, KeyError) as error:
        raise CheckpointError(f"{path}: the weights do not fit the network {name!r} ({first_line(error)})") from None
    return name, network.eval(), float(content["far"]), dict(content["facts"])


def read_torch(path: Path) -> Any:
    """What :func:`write_torch` has written, on the CPU.

    Raises:
        OSError: There is no such file, or it cannot be read.
        CheckpointError: torch has not written it, or it is cut short.
    """
    import torch

    with path.open("rb") as file:
        try:
            # Tensors and plain values only: a checkpoint cannot run code.
            return torch.load(file, map_location="cpu", weights_only=True)
        except Exception as error:  # torch's reader raises whatever it trips over
            raise CheckpointError(f"{path}: not a checkpoint, or cut short ({first_line(error)})") from None


def first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


class SixDirectionPolicy:
    """A trained network at work."""

    def __init__(self, name: str, network: Any, far: float) -> None:
        self.name = name
        self.network = network
        self.far = far
        self._size = architecture(name).size

    @classmethod
    def load(cls, path: str | Path = "") -> SixDirectionPolicy:
        """From a checkpoint; the weights that come with the package if no path is given.

        Raises:
            ImportError: torch is not installed.
            OSError, CheckpointError: See :func:`load_checkpoint`.
        """
        try:
            import torch  # noqa: F401
        except ImportError:
            raise ImportError("the six-direction CNN needs torch: pip install 'nbv-gym[train]'") from None
        name, network, far, _ = load_checkpoint(Path(path) if path else WEIGHTS)
        return cls(name, network, far)

    def probabilities(self, depth: NDArray[np.float32]) -> NDArray[np.float64]:
        """Soft-max over :data:`LABELS`, (n, 6), of depth images (n, h, w), metres."""
        import torch

        with torch.inference_mode():
            inputs = network_input(torch.from_numpy(np.ascontiguousarray(depth, dtype=np.float32)), self.far, self._size)
            logits = self.network(inputs).double()
        return np.asarray(torch.softmax(logits, dim=1))

    def direction(self, depth: NDArray[np.float32], camera: Camera) -> int:
        """Index into :data:`LABELS` of the direction that one image (h, w) suggests: y(D) = arg max f(D)."""
        if depth.shape != (camera.height, camera.width):
            raise ValueError(f"depth must have the camera's shape ({camera.height}, {camera.width}), got {depth.shape}")
        return int(self.probabilities(depth[None])[0].argmax())
