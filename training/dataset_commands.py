"""`nbv-gym dataset`: data sets to learn from."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from .command_errors import clear_errors

app = typer.Typer(
    help="Make data sets to learn from.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def root() -> None:
    """One command a data set."""


@app.command("six-directions")
@clear_errors
def six_directions(
    out: Annotated[Path, typer.Option("--out", help="Folder of the data set; one that was interrupted is gone on with.")],
    views: Annotated[int, typer.Option(help="Views, equally many of each direction.", min=1)] = 7920,
    scene: Annotated[
        list[str] | None,
        typer.Option(help="A kind of generated scenes, or a world file; may be given more than once.", show_default="room"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the views.", min=0)] = 0,
    workers: Annotated[int, typer.Option(help="Processes; the data set does not depend on it.", min=1)] = 1,
    width: Annotated[int, typer.Option(help="Of the images, pixels.", min=1)] = 128,
    height: Annotated[int, typer.Option(help="Of the images, pixels.", min=1)] = 96,
    resolution: Annotated[float, typer.Option(help="Side of the voxels that are counted, metres.")] = 0.025,
    min_objects: Annotated[int, typer.Option(help="Objects that a view must hold.", min=0)] = 3,
    per_scene: Annotated[int, typer.Option(help="Views of each direction from one scene, at most.", min=1)] = 6,
) -> None:
    """Depth images with the direction in which most surface comes into view (Wang et al. 2019, section IV-B).

    Scenes come from seed 1000 on, so that those that tasks use stay new to a network. Ctrl-C, a crash or a power cut lose at
    most the scenes in flight; the same command goes on from there, and mends files that are cut short.

    Examples:

    - `nbv-gym dataset six-directions --out out/six_directions`
    - `nbv-gym dataset six-directions --views 600 --workers 2 --scene room --scene office --out out/some`
    """
    from .dataset import Spec, generate
    from .terminal import bar, terminal

    spec = Spec(
        views=views, scenes=tuple(scene or ["room"]), seed=seed, width=width, height=height, resolution=resolution,
        min_objects=min_objects, per_scene=per_scene,
    )  # fmt: skip
    console = terminal()
    begin, counts = time.perf_counter(), [0, 0]
    with bar(console) as progress:
        work = progress.add_task("Views", total=views)

        def note(done: int, wanted: int) -> None:
            counts[0] = done
            rate = done / max(time.perf_counter() - begin, 1e-9)
            progress.update(work, completed=done, total=wanted, description=f"Views, {rate:.1f}/s")

        manifest = generate(spec, out, workers, note)
    seconds = time.perf_counter() - begin
    console.print(
        f"{out}: {counts[0]} views of {len(manifest['units'])} scenes in {seconds:.1f} s ({counts[0] / seconds:.1f} views/s), "
        f"data set {manifest['content']}",
        highlight=False,
    )
