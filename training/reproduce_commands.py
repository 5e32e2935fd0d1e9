"""`nbv-gym reproduce`: a paper's experiments, its figures beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .command_errors import clear_errors

app = typer.Typer(
    help="Run a paper's experiments; its figures beside ours.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def root() -> None:
    """One command a paper."""


@app.command()
@clear_errors
def wang2019(
    out: Annotated[Path, typer.Option(help="Folder for episodes, results and the report.")] = Path("out/wang2019"),
    quick: Annotated[bool, typer.Option("--quick", help="Coarse voxels, few steps and runs: a few minutes.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on after an interruption: finished episodes are kept.")] = False,
    processes: Annotated[int, typer.Option(help="Episodes at a time; results do not depend on it.", min=1)] = 1,
    rooms: Annotated[
        str | None,
        typer.Option(help="Generated rooms, separated by commas; `none` for only --scene.", show_default="four of rising complexity"),
    ] = None,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A world file in the place of a real room, with a Kinect's noise; may be given more than once.", show_default="none"
        ),
    ] = None,
    methods: Annotated[
        str | None, typer.Option(help="Methods, separated by commas.", show_default="the paper's ten, and the oracle")
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Runs of each method in each room.", show_default="5; quick: 2", min=1)] = None,
    seed: Annotated[int, typer.Option(help="The first seed.", min=0)] = 0,
    steps: Annotated[int | None, typer.Option(help="Steps of a run.", show_default="130; quick: 40", min=1)] = None,
    resolution: Annotated[float | None, typer.Option(help="Side of a voxel, metres.", show_default="0.025; quick: 0.1")] = None,
    robot: Annotated[str | None, typer.Option(help="`flying`, or `arm`: the camera in the hand of an arm.", show_default="flying")] = None,
    weights: Annotated[str, typer.Option(help="Checkpoint of the CNN.", show_default="the one that comes with the package")] = "",
) -> None:
    """Wang et al. 2019, "Autonomous 3D reconstruction, mapping and exploration of indoor environments with a robotic arm".

    Writes results.json (a row per scene, method and metric, with the paper's figure where it prints one) and a report (report.html, one
    file; report.md) with Table I, Fig. 6 and Fig. 7. Episodes are on disk as they finish; Ctrl-C loses at most those in flight.

    Examples:

    - `nbv-gym reproduce wang2019 --quick --out out/quick`
    - `nbv-gym reproduce wang2019 --processes 2 --scene house.world --out out/wang2019 --resume`
    """
    from .cli import split
    from .reproduce_wang2019 import FULL, METHODS, QUICK, Experiment, reproduce
    from .terminal import terminal
    from .wang2019_paper import ROOMS

    size = QUICK if quick else FULL
    count = size.seeds if seeds is None else seeds
    experiment = Experiment(
        rooms=tuple(ROOMS if rooms is None else split(rooms) if rooms != "none" else ()),
        scenes=tuple(scene or ()),
        methods=tuple(METHODS if methods is None else split(methods)),
        seeds=tuple(range(seed, seed + count)),
        steps=size.steps if steps is None else steps,
        resolution=size.resolution if resolution is None else resolution,
        weights=weights,
        # The tasks fly: the same runs, by whatever words.
        robot=None if robot == "flying" else robot,
    )
    if reproduce(experiment, out, resume, processes, terminal()):
        raise typer.Exit(1)
