"""`nbv-gym train cnn`: the six-direction CNN (Wang et al. 2019, section IV) on a data set of `nbv-gym dataset six-directions`.

Writes, for each fold, a checkpoint after every epoch (`resume` goes on from it), TensorBoard events where tensorboard is
installed, and a report: training and validation accuracy, chance, majority class, top-2 accuracy, share of the gain that the
chosen direction gets, confusion matrix. Needs the extra `train`; uses CUDA where there is one.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..agents.six_direction import (
    LABELS,
    MIRRORED,
    CheckpointError,
    architecture,
    first_line,
    load_checkpoint,
    network_input,
    read_torch,
    save_checkpoint,
    write_torch,
)
from .dataset import DataSet, batches, load, split_scenes
from .shards import write_bytes, write_whole

if TYPE_CHECKING:
    import torch

#: Called with the fold, the epochs of it that are over, as a fraction, and at the end of an epoch with its figures.
Progress: TypeAlias = Callable[[int, float, dict[str, Any] | None], None]
#: The paper's accuracies over three folds, training and validation.
PAPER = {"training": 0.824, "validation": 0.643}
#: What the state of a training holds; on CUDA also "cuda_rng".
STATE = {"args", "epoch", "history", "network", "optimiser", "rng", "torch_rng"}


@dataclasses.dataclass
class Args:
    """How the network is trained. The defaults of `alexnet` are the paper's (section IV-A), which gives no batch size."""

    #: Folder of the data set.
    data: str = "out/six_directions"
    #: alexnet or small.
    network: str = "alexnet"
    epochs: int = 10
    learning_rate: float = 1e-2
    momentum: float = 0.9
    weight_decay: float = 5e-4
    batch_size: int = 32
    #: The learning rate falls to 0 along half a cosine; else it stays.
    cosine: bool = False
    #: Mirror half of the images, right and left change places.
    mirror: bool = False
    #: Weight of soft targets (a soft-max of the six gains) against the hard label, in [0, 1].
    soft: float = 0.0
    #: Temperature of the soft targets, in standard deviations of a view's gains.
    temperature: float = 0.5
    #: Plain label smoothing.
    smoothing: float = 0.0
    #: Folds, each with its own split by scenes.
    folds: int = 3
    validation: float = 0.2
    seed: int = 0
    #: What training computes in: float32, or bfloat16, where weights, their updates and the evaluation stay in float32. A third of
    #: the time for AlexNet on processors with matrix units for bfloat16 (AMX).
    precision: str = "float32"
    #: Threads of torch; 0 leaves torch's choice.
    torch_threads: int = 0
    #: cpu, cuda, or auto.
    device: str = "auto"
    out: str = "out/cnn"
    resume: bool = False

    def __post_init__(self) -> None:
        architecture(self.network)
        for name, value in dataclasses.asdict(self).items():
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{name} must be finite, got {value}")
        for name in ("epochs", "batch_size", "folds"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("soft", "smoothing", "momentum"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        for name in ("learning_rate", "temperature"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.weight_decay < 0:
            raise ValueError(f"weight_decay must be >= 0, got {self.weight_decay}")
        if not 0 < self.validation < 1:
            raise ValueError(f"validation must lie in (0, 1), got {self.validation}")
        if self.device not in ("auto", "cpu", "cuda"):
            raise ValueError(f"device must be auto, cpu or cuda, got {self.device!r}")
        if self.precision not in ("float32", "bfloat16"):
            raise ValueError(f"precision must be float32 or bfloat16, got {self.precision!r}")


def practical(**changes: Any) -> Args:
    """The settings of the small network whose weights come with the package."""
    return Args(
        **{
            "network": "small",
            "epochs": 24,
            "batch_size": 128,
            "cosine": True,
            "mirror": True,
            "soft": 0.5,
            "learning_rate": 2e-2,
            **changes,
        }
    )


@dataclasses.dataclass
class Scores:
    """What a network is worth on some views."""

    accuracy: float
    top2: float
    #: Sum of the chosen directions' gains over the sum of the best ones'.
    gain_share: float
    loss: float
    #: Rows: the label; columns: what the network said.
    confusion: list[list[int]]


def score(logits: NDArray[np.float64], label: NDArray[np.int64], gain: NDArray[np.int32]) -> Scores:
    """From logits (n, 6), labels (n,) and gains (n, 6)."""
    n = len(label)
    order = np.argsort(-logits, axis=1, kind="stable")
    chosen = order[:, 0]
    confusion = np.zeros((len(LABELS), len(LABELS)), dtype=np.int64)
    np.add.at(confusion, (label, chosen), 1)
    shifted = logits - logits.max(axis=1, keepdims=True)
    loss = np.log(np.exp(shifted).sum(axis=1)) - shifted[np.arange(n), label]
    best = gain.max(axis=1).astype(np.float64).sum()
    got = gain[np.arange(n), chosen].astype(np.float64).sum()
    return Scores(
        accuracy=float((chosen == label).mean()),
        top2=float((order[:, :2] == label[:, None]).any(axis=1).mean()),
        gain_share=float(got / best) if best > 0 else float("nan"),
        loss=float(loss.mean()),
        confusion=confusion.tolist(),
    )


def chosen_device(wanted: str) -> torch.device:
    """`auto` is CUDA where there is one.

    Raises:
        ValueError: CUDA was asked for, and there is none.
    """
    import torch

    if wanted == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda was asked for, but torch sees none")
    return torch.device("cuda" if wanted != "cpu" and torch.cuda.is_available() else "cpu")


class Fold:
    """One network in training. Images stay where `inputs` are; a batch goes to the network's device."""

    def __init__(self, args: Args, data: DataSet, inputs: torch.Tensor, fold: int) -> None:
        import torch

        self.args, self.data, self.inputs, self.number = args, data, inputs, fold
        self.folder = Path(args.out) / f"fold-{fold}"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.train, self.validate = split_scenes(data.scene, args.validation, args.seed * 1000 + fold)
        self.device = chosen_device(args.device)
        torch.manual_seed(args.seed * 1000 + fold)
        self.rng = np.random.default_rng([args.seed, fold])
        self.network = architecture(args.network).build().to(self.device)
        if args.precision == "bfloat16":  # the order of an image's values in which its convolutions are quickest
            self.network = self.network.to(memory_format=torch.channels_last)
        parameters = self.network.parameters()
        self.optimiser = torch.optim.SGD(parameters, args.learning_rate, args.momentum, weight_decay=args.weight_decay)
        self.targets = self._targets().to(inputs.device)
        self.epoch = 0
        self.history: list[dict[str, Any]] = []

    def _targets(self) -> torch.Tensor:
        """(n, 6) what the network is to say: the label, softened by the gains and smoothed."""
        import torch

        args = self.args
        hard = np.eye(len(LABELS))[self.data.label]
        gain = self.data.gain.astype(np.float64)
        scaled = gain / (args.temperature * np.maximum(gain.std(axis=1, keepdims=True), 1e-9))
        soft = np.exp(scaled - scaled.max(axis=1, keepdims=True))
        soft /= soft.sum(axis=1, keepdims=True)
        target = (1 - args.soft) * hard + args.soft * soft
        target = (1 - args.smoothing) * target + args.smoothing / len(LABELS)
        return torch.from_numpy(target.astype(np.float32))

    def resume(self) -> None:
        """Go on from the last epoch on disk, if there is one.

        Raises:
            CheckpointError: The file is damaged, or something else.
            ValueError: It is of a training with other arguments, or with more epochs than are asked for.
        """
        import torch

        path = self.folder / "last.pt"
        if not path.exists():
            return
        state = read_torch(path)
        lacking = STATE - set(state if isinstance(state, dict) else ())
        if lacking:
            raise CheckpointError(f"{path}: not the state of a training, it lacks {', '.join(sorted(lacking))}")
        try:
            there, history, rng = (json.loads(state[key]) for key in ("args", "history", "rng"))
            now, free = self._facts(), {"folds"}
            if not self.args.cosine:  # which alone makes an epoch depend on how many there are to be
                free.add("epochs")
            differ = [f"{key}: {there.get(key)!r} there, {now[key]!r} now" for key in now if key not in free and there.get(key) != now[key]]
            epoch = int(state["epoch"])
            if not differ:
                self.network.load_state_dict(state["network"])
                self.optimiser.load_state_dict(state["optimiser"])
                torch.set_rng_state(state["torch_rng"])
                if self.device.type == "cuda" and "cuda_rng" in state:
                    torch.cuda.set_rng_state(state["cuda_rng"], self.device)
                self.rng.bit_generator.state = rng
        except (RuntimeError, LookupError, TypeError, AttributeError, ValueError) as error:
            raise CheckpointError(f"{path}: damaged ({first_line(error)})") from None
        if differ:
            raise ValueError(f"{path}: training with other arguments ({', '.join(differ)}); choose another folder, or leave --resume out")
        if epoch > self.args.epochs:
            raise ValueError(f"{path}: {epoch} epochs are over, more than the {self.args.epochs} that are asked for")
        self.epoch, self.history = epoch, history

    def _facts(self) -> dict[str, Any]:
        """What decides the outcome."""
        facts = dataclasses.asdict(self.args)
        for name in ("resume", "out", "torch_threads", "device", "data"):
            facts.pop(name)
        return {**facts, "data": self.data.digest}

    def save(self) -> None:
        """Everything that the next epoch needs, in one step."""
        import torch

        streams = {"torch_rng": torch.get_rng_state()}
        if self.device.type == "cuda":  # dropout draws there
            streams["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        write_torch(
            self.folder / "last.pt",
            {
                **streams, "args": json.dumps(self._facts()), "epoch": self.epoch, "history": json.dumps(self.history),
                "network": self.network.state_dict(), "optimiser": self.optimiser.state_dict(),
                "rng": json.dumps(self.rng.bit_generator.state),
            },
        )  # fmt: skip

    def run_epoch(self, step: Callable[[float], None] | None = None) -> float:
        """Share of the images whose direction was right when it was their turn. `step` hears the epochs that are over."""
        import torch

        args = self.args
        if args.cosine:
            for group in self.optimiser.param_groups:
                group["lr"] = args.learning_rate * 0.5 * (1 + math.cos(math.pi * self.epoch / args.epochs))
        self.network.train()
        right = torch.zeros((), dtype=torch.int64, device=self.device)
        seen = 0
        # float32 is what it says (no TF32), and a step gives the same bits each time.
        with torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False):
            for rows in batches(self.rng.permutation(self.train), args.batch_size):
                if len(rows) < 2:  # batch normalisation needs two
                    continue
                right += self._step(rows)
                seen += len(rows)
                if step is not None:
                    step(self.epoch + seen / len(self.train))
        self.epoch += 1
        return int(right) / max(seen, 1)

    def _step(self, rows: NDArray[np.intp]) -> torch.Tensor:
        """One batch; how many of its directions were right, on the network's device."""
        import torch

        args, store = self.args, self.inputs.device
        chosen = torch.from_numpy(rows).to(store)
        images, targets = self.inputs[chosen].float(), self.targets[chosen]
        if args.mirror:
            flip = torch.from_numpy(self.rng.random(len(rows)) < 0.5).to(store)
            images = torch.where(flip[:, None, None, None], images.flip(3), images)
            targets = torch.where(flip[:, None], targets[:, torch.tensor(MIRRORED, device=store)], targets)
        images, targets = images.to(self.device), targets.to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=args.precision == "bfloat16"):
            logits = self.network(images).float()
        loss = torch.nn.functional.cross_entropy(logits, targets)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimiser.step()
        # Of mirrored images by the mirrored label: the hard part of a target is its largest.
        return (logits.detach().argmax(1) == targets.argmax(1)).sum()

    def evaluate(self, rows: NDArray[np.intp]) -> Scores:
        """What the network is worth on some views.

        Raises:
            RuntimeError: The training has diverged.
        """
        import torch

        self.network.eval()
        parts = []
        with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False):
            for part in batches(rows, 256):
                images = self.inputs[torch.from_numpy(part).to(self.inputs.device)].float()
                parts.append(self.network(images.to(self.device)).double().cpu().numpy())
        logits = np.concatenate(parts)
        if not np.isfinite(logits).all():
            raise RuntimeError(
                f"fold {self.number}, epoch {self.epoch}: the loss is not finite, the training has diverged; "
                f"a learning rate below {self.args.learning_rate} may help ({self.folder} keeps what was there before this epoch)"
            )
        return score(logits, self.data.label[rows], self.data.gain[rows])


def train(args: Args, progress: Progress | None = None) -> dict[str, Any]:
    """Train all folds; returns the report and writes it to `out/report.json` and `out/report.md`.

    Args:
        args: How.
        progress: See :data:`Progress`.

    Raises:
        OSError, ValueError: No data set, a damaged one, or one of too few scenes; arguments that do not fit.
        ImportError: torch is not installed.
        RuntimeError: A training has diverged; the last good epoch is on disk.
    """
    data = load(Path(args.data))
    try:
        import torch
    except ImportError:
        raise ImportError("training needs torch: pip install 'nbv-gym[train]'") from None
    if args.torch_threads:
        torch.set_num_threads(args.torch_threads)
    device = chosen_device(args.device)
    size, far = architecture(args.network).size, float(data.spec["far"])
    inputs = torch.cat(
        [network_input(torch.from_numpy(data.depth[rows].astype(np.float32) / 1000.0), far, size).half()
         for rows in batches(np.arange(len(data)), 512)]
    )  # fmt: skip
    # Beside the network, if that leaves it half of what is free: batches of small networks are quicker than their transport.
    if device.type == "cuda" and 2 * inputs.nbytes < torch.cuda.mem_get_info()[0]:
        inputs = inputs.to(device)
    started = time.time()
    folds: list[dict[str, Any]] = []
    for number in range(args.folds):
        fold = Fold(args, data, inputs, number)
        if args.resume:
            fold.resume()
            if progress is not None:
                progress(number, fold.epoch, None)
        board = _tensorboard(fold.folder)
        while fold.epoch < args.epochs:
            # With dropout and while the weights change, so a little below what the report says.
            training = fold.run_epoch(None if progress is None else functools.partial(_between, progress, number))
            validation = fold.evaluate(fold.validate)
            figures = {
                "epoch": fold.epoch, "training": training, "validation": validation.accuracy,
                "validation_loss": validation.loss, "gain_share": validation.gain_share,
            }  # fmt: skip
            fold.history.append(figures)
            fold.save()
            if board is not None:
                for name, value in figures.items():
                    board.add_scalar(name, value, fold.epoch)
            if progress is not None:
                progress(number, fold.epoch, figures)
        if board is not None:
            board.close()
        final, validation = fold.evaluate(fold.train), fold.evaluate(fold.validate)
        majority = np.bincount(data.label[fold.train], minlength=len(LABELS)).argmax()
        facts = {
            "training": dataclasses.asdict(final), "validation": dataclasses.asdict(validation), "history": fold.history,
            "views": {"training": len(fold.train), "validation": len(fold.validate)},
            "majority": float((data.label[fold.validate] == majority).mean()),
        }  # fmt: skip
        folds.append(facts)
        described = {
            "args": fold._facts(), "data": data.spec, "digest": data.digest, "fold": number, "half": args.network == "small",
            "accuracy": {"training": final.accuracy, "validation": validation.accuracy}, "versions": {"torch": str(torch.__version__)},
        }  # fmt: skip
        save_checkpoint(fold.folder / f"six_direction_{args.network}.pt", args.network, fold.network, far, described)
    report = {
        "args": dataclasses.asdict(args), "data": data.spec, "digest": data.digest, "chance": 1 / len(LABELS), "paper": PAPER,
        "parameters": sum(p.numel() for p in fold.network.parameters()), "seconds": time.time() - started, "folds": folds,
        "mean": {part: {key: float(np.mean([f[part][key] for f in folds])) for key in ("accuracy", "top2", "gain_share")}
                 for part in ("training", "validation")},
    }  # fmt: skip
    out = Path(args.out)
    write_whole(out / "report.json", json.dumps(report, indent=1) + "\n")
    write_whole(out / "report.md", report_text(report))
    return report


def _between(progress: Progress, fold: int, epochs: float) -> None:
    progress(fold, epochs, None)


def _tensorboard(folder: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(folder / "events")


def report_text(report: dict[str, Any]) -> str:
    """The report in Markdown, the paper's figures beside ours."""
    mean, folds = report["mean"], report["folds"]

    def percent(value: float) -> str:
        return f"{value * 100:.1f} %"

    def spread(part: str) -> str:
        return f" ± {np.std([f[part]['accuracy'] for f in folds]) * 100:.1f}" if len(folds) > 1 else ""

    lines = [
        f"# Six-direction CNN: {report['args']['network']}, {report['parameters'] / 1e6:.2f} M parameters",
        "",
        f"{report['data']['views']} views (data set {report['digest']}), {len(folds)} fold{'s'[: len(folds) > 1]} split by scenes, "
        f"{report['args']['epochs']} epochs, {report['seconds'] / 60:.1f} minutes.",
        "",
        "| | ours | paper |",
        "|---|---|---|",
        f"| training accuracy | {percent(mean['training']['accuracy'])}{spread('training')} | {percent(PAPER['training'])} |",
        f"| validation accuracy | {percent(mean['validation']['accuracy'])}{spread('validation')} | {percent(PAPER['validation'])} |",
        f"| chance | {percent(report['chance'])} | |",
        f"| majority class | {percent(float(np.mean([f['majority'] for f in folds])))} | |",
        f"| validation, top 2 | {percent(mean['validation']['top2'])} | |",
        f"| share of the gain captured, validation | {percent(mean['validation']['gain_share'])} | |",
        "",
        "Confusion on the validation views of all folds (rows: the best direction, columns: the network's):",
        "",
        "| | " + " | ".join(LABELS) + " |",
        "|---" * (len(LABELS) + 1) + "|",
    ]
    confusion = np.sum([f["validation"]["confusion"] for f in folds], axis=0)
    lines += [f"| {label} | " + " | ".join(str(x) for x in row) + " |" for label, row in zip(LABELS, confusion, strict=True)]
    return "\n".join(lines) + "\n"


def export_onnx(checkpoint: Path, path: Path) -> None:
    """Write the network of a checkpoint as ONNX, in one step: input `depth` (n, 1, size, size) as :func:`network_input` makes it, output
    `logits` (n, 6).

    Raises:
        OSError, CheckpointError: See :func:`nbv_gym.agents.six_direction.load_checkpoint`.
    """
    import torch

    name, network, _, _ = load_checkpoint(checkpoint)
    size = architecture(name).size
    example = torch.zeros(1, 1, size, size)
    axes = {"depth": {0: "n"}, "logits": {0: "n"}}
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / path.name
        # The exporter that torch recommends instead needs onnxscript.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network, (example,), str(draft), input_names=["depth"], output_names=["logits"], dynamic_axes=axes, dynamo=False
        )  # fmt: skip
        write_bytes(path, draft.read_bytes())
