"""`nbv-gym train`: learned parts of planners."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from .command_errors import clear_errors

app = typer.Typer(
    help="Train the learned parts of planners (`pip install 'nbv-gym[train]'`).",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def root() -> None:
    """One command a network."""


@app.command()
@clear_errors
def cnn(
    data: Annotated[Path, typer.Option(help="Folder of the data set, from `nbv-gym dataset six-directions`.")] = Path("out/six_directions"),
    out: Annotated[Path, typer.Option(help="Folder for checkpoints and the report.")] = Path("out/cnn"),
    network: Annotated[str, typer.Option(help="small (whose weights come along), or alexnet, with the paper's settings.")] = "small",
    epochs: Annotated[int | None, typer.Option(help="Times that each image is seen.", show_default="the network's", min=1)] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Of the first epoch.", show_default="the network's")] = None,
    batch_size: Annotated[int | None, typer.Option(help="Images a step.", show_default="the network's", min=2)] = None,
    soft: Annotated[
        float | None, typer.Option(help="Weight of targets made of all six gains, against the label.", show_default="the network's")
    ] = None,
    mirror: Annotated[bool | None, typer.Option(help="Mirror half of the images.", show_default="the network's")] = None,
    folds: Annotated[int, typer.Option(help="Trainings, each with its own split by scenes.", min=1)] = 3,
    seed: Annotated[int, typer.Option(help="Of splits, weights and batches.", min=0)] = 0,
    precision: Annotated[str, typer.Option(help="float32, or bfloat16: quicker on processors with matrix units (AMX).")] = "float32",
    torch_threads: Annotated[int, typer.Option(help="Threads of torch; 0: torch's choice.", min=0)] = 0,
    device: Annotated[str, typer.Option(help="cpu, cuda or auto.")] = "auto",
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last finished epoch.")] = False,
    onnx: Annotated[Path | None, typer.Option(help="Write the first fold's network as ONNX, too.")] = None,
) -> None:
    """Train the six-direction CNN (Wang et al. 2019, section IV).

    Examples:

    - `nbv-gym train cnn --data out/six_directions`
    - `nbv-gym train cnn --network alexnet --device cuda --out out/alexnet`
    """
    from .terminal import bar, terminal
    from .train_cnn import Args, export_onnx, practical, report_text, train

    given: dict[str, Any] = {
        "epochs": epochs, "learning_rate": learning_rate, "batch_size": batch_size, "soft": soft, "mirror": mirror,
    }  # fmt: skip
    chosen: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    chosen |= {
        "data": str(data), "out": str(out), "folds": folds, "seed": seed, "precision": precision, "torch_threads": torch_threads,
        "device": device, "resume": resume,
    }  # fmt: skip
    args = practical(**chosen) if network == "small" else Args(network=network, **chosen)
    if onnx is not None:
        # What would fail after hours fails now.
        if onnx.is_dir():
            raise IsADirectoryError(f"--onnx {onnx}: a folder, name a file")
        onnx.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(onnx.parent, os.W_OK):
            raise PermissionError(f"--onnx {onnx}: the folder cannot be written")
    console = terminal()
    with bar(console) as progress:
        work = progress.add_task("Epochs", total=args.folds * args.epochs)

        def note(fold: int, epochs: float, figures: dict[str, Any] | None) -> None:
            progress.update(work, completed=fold * args.epochs + epochs)
            if figures is not None:
                text = f"fold {fold}, training {figures['training']:.3f}, validation {figures['validation']:.3f}"
                progress.update(work, description=text)

        report = train(args, note)
    console.print(report_text(report), highlight=False, markup=False)
    checkpoint = out / "fold-0" / f"six_direction_{network}.pt"
    if onnx is not None:
        export_onnx(checkpoint, onnx)
        console.print(f"  {onnx}", highlight=False)
    console.print(f"  {checkpoint}\n", highlight=False)
