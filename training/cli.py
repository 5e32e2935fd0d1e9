"""The command line `nbv-gym`. Heavy imports stand inside the commands, so that `--help` is quick."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Optional

import typer

from .command_errors import clear_errors, set_debug
from .scene_commands import app as scenes_app

CONTEXT = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    name="nbv-gym",
    help="Next-best-view planning: worlds, maps, planners, and what they are worth.",
    epilog="Errors are one line; `nbv-gym --debug COMMAND ...` shows where they come from.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings=CONTEXT,
    pretty_exceptions_enable=False,
)
app.add_typer(scenes_app, name="scenes")

Seed = Annotated[int, typer.Option("--seed", help="The first seed.", min=0)]
Seeds = Annotated[int, typer.Option("--seeds", help="How many seeds, counted up from --seed; each is one episode.", min=1)]


@app.callback()
def root(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    set_debug(debug)
    if version:
        from .. import __version__

        typer.echo(f"nbv-gym {__version__}")
        raise typer.Exit


@app.command()
@clear_errors
def demo(
    scene: Annotated[Optional[str], typer.Option("--scene", help="Explore this world file, too (.world .sdf .dae .glb .gltf .obj .ply .stl).")] = None,  # noqa: UP045
    out: Annotated[Path, typer.Option("--out", help="Folder for pictures and results.")] = Path("out/demo"),
    seeds: Seeds = 3,
    seed: Seed = 0,
    views: Annotated[Optional[int], typer.Option("--views", help="Views per episode after the first.", min=1)] = None,  # noqa: UP045
) -> None:
    """Watch four planners explore the same furnished room, and a world of yours.

    Greedy gain, nearest frontier, random and the oracle (which cheats: it tries views out in the true scene) get the
    same seeds. Prints a table and writes coverage curves, maps from above, depth images, a GIF of the growing map,
    results as JSON, and, where rerun-sdk is installed, a recording.

    Examples:

    - `nbv-gym demo`
    - `nbv-gym demo --scene house/worlds/house.world --seeds 5 --out out/house`
    """
    from rich.console import Console

    from .demo import demo as run_demo

    run_demo(out, scene, range(seed, seed + seeds), views, Console())


@app.command()
@clear_errors
def evaluate(
    task: Annotated[str, typer.Option("--task", help="Tasks, separated by commas: dome_room, six_directions, tabletop.")] = "dome_room",
    agents: Annotated[str, typer.Option("--agents", help="Planners, separated by commas, with parameters after colons: `greedy:metric=entropy`.")] = "greedy,nearest_frontier,random,oracle",
    scene: Annotated[Optional[list[str]], typer.Option("--scene", help="A world file, or `room`, `room:7`, `room:0-63`; may be given more than once. Default: the task's own.")] = None,  # noqa: UP006, UP045
    seeds: Seeds = 5,
    seed: Seed = 0,
    views: Annotated[Optional[int], typer.Option("--views", help="Views per episode after the first. Default: the task's own.", min=1)] = None,  # noqa: UP045
    json_file: Annotated[Optional[Path], typer.Option("--json", help="Results go here; episodes as they finish into FILE.shards. Default: results.json in --out.")] = None,  # noqa: UP045
    out: Annotated[Optional[Path], typer.Option("--out", help="Folder for curves as a picture; out/evaluate if neither --out nor --json is given.")] = None,  # noqa: UP045
    resume: Annotated[bool, typer.Option("--resume", help="Go on after an interruption: finished episodes are not run again.")] = False,
    processes: Annotated[int, typer.Option("--processes", help="Episodes at a time; results do not depend on it.", min=1)] = 1,
) -> None:
    """Compare planners: mean and 95 % confidence interval over seeds.

    One record per episode is on disk as soon as the episode is over; Ctrl-C, a crash or a power cut lose at most the
    episodes in flight, and `--resume` goes on from there. An episode that fails is reported and stops no other.

    Examples:

    - `nbv-gym evaluate --task dome_room --agents greedy,random --seeds 5 --json results.json`
    - `nbv-gym evaluate --agents greedy:metric=entropy,greedy:metric=uncertainty,oracle --scene room:7 --processes 2`
    - `nbv-gym evaluate --task six_directions --scene a.world --scene b.glb --json all.json --resume`
    """
    from rich.console import Console

    from .evaluate_command import evaluate_command

    folder = out if out is not None or json_file is not None else Path("out/evaluate")
    target = json_file if json_file is not None else (folder or Path()) / "results.json"
    failed = evaluate_command(
        split(task), split(agents), scene or [None], range(seed, seed + seeds), views, target, folder, resume, processes, Console()
    )  # fmt: skip
    if failed:
        raise typer.Exit(1)


def split(text: str) -> list[str]:
    """Names between commas, each once."""
    return list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


@app.command()
@clear_errors
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and smaller cases, under two minutes.")] = False,
    json_file: Annotated[Optional[Path], typer.Option("--json", help="Write figures and ratios to this file.")] = None,  # noqa: UP045
    seed: Seed = 0,
) -> None:
    """Measure speed: environment, rendering, map, gains; and peers where they are installed.

    Peers (`pip install nbv-gym[bench]`) are measured in turns with this package, so that a busy machine slows both;
    a ratio is the median over the turns.

    Examples:

    - `nbv-gym bench`
    - `nbv-gym bench --quick --json bench.json`
    """
    from rich.console import Console

    from .benchmark import bench as run_bench

    run_bench(quick, json_file, seed, Console())


@app.command()
@clear_errors
def view(
    source: Annotated[str, typer.Argument(help="A world file, a generated scene (`room:7`), or a results file of evaluate or demo.", show_default=False)],
    out: Annotated[Optional[Path], typer.Option("--out", help="The picture (.png), film (.gif) or recording (.rrd) to write.")] = None,  # noqa: UP045
    episode: Annotated[int, typer.Option("--episode", help="Which episode of a results file, counted from 0.", min=0)] = 0,
    resolution: Annotated[float, typer.Option("--resolution", help="Side of the voxels in which a scene is drawn, metres.", min=0.01)] = 0.05,
) -> None:
    """Draw a scene, or play an episode again.

    A scene becomes a picture: an oblique view without ceilings, a plan, and depth images from its start positions. An
    episode of a results file is run again from its recorded actions and filmed, or recorded for the Rerun viewer.

    Examples:

    - `nbv-gym view house.world --out house.png`
    - `nbv-gym view out/demo/room/results.json --episode 2 --out greedy.gif`
    """
    from rich.console import Console

    from .view_command import view_command

    view_command(source, out, episode, resolution, Console())


def main() -> None:
    """Entry point of the console script: `--debug` may stand anywhere."""
    arguments = sys.argv[1:]
    if "--debug" in arguments:
        arguments = ["--debug", *(a for a in arguments if a != "--debug")]
    app(args=arguments, prog_name="nbv-gym")
