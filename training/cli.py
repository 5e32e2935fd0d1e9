"""The command line `nbv-gym`. Heavy imports stand inside the commands, so that `--help` is quick."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .command_errors import clear_errors, set_debug
from .dataset_commands import app as dataset_app
from .reproduce_commands import app as reproduce_app
from .scene_commands import app as scenes_app
from .train_commands import app as train_app

if TYPE_CHECKING:
    from .manifest import Row

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
app.add_typer(dataset_app, name="dataset")
app.add_typer(train_app, name="train")
app.add_typer(reproduce_app, name="reproduce")

ALL_PLANNERS = "greedy,nearest_frontier,random,oracle"
Seed = Annotated[int, typer.Option(help="The first seed.", min=0)]
Seeds = Annotated[int, typer.Option(help="How many seeds, counted up from --seed; each is one episode.", min=1)]
Views = Annotated[int | None, typer.Option(help="Views per episode after the first.", show_default="the task's", min=1)]


def print_version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        typer.echo(f"nbv-gym {__version__}")
        raise typer.Exit


@app.callback()
def root(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=print_version)] = False,
) -> None:
    set_debug(debug)


@app.command()
@clear_errors
def demo(
    scene: Annotated[str | None, typer.Option(help="Explore this world file, too (.world .sdf .dae .glb .gltf .obj .ply .stl).")] = None,
    out: Annotated[Path, typer.Option(help="Folder for pictures and results.")] = Path("out/demo"),
    seeds: Seeds = 5,
    seed: Seed = 0,
    views: Views = None,
) -> None:
    """Watch four planners explore the same furnished room, and a world of yours.

    Greedy gain, nearest frontier, random and the oracle (which cheats: it tries views out in the true scene) get the
    same seeds. Prints a table and writes coverage curves, maps from above, depth images, a GIF of the growing map,
    results as JSON, and, where rerun-sdk is installed, a recording.

    Examples:

    - `nbv-gym demo`
    - `nbv-gym demo --scene house/worlds/house.world --seeds 5 --out out/house`
    """
    from .demo import demo as run_demo
    from .terminal import terminal

    run_demo(out, scene, range(seed, seed + seeds), views, terminal())


@app.command()
@clear_errors
def evaluate(
    task: Annotated[
        str, typer.Option(help="Tasks, separated by commas: dome_room, six_directions, tabletop, wang2019, wang2019_kinect.")
    ] = "dome_room",
    agents: Annotated[
        str, typer.Option(help="Planners, separated by commas; parameters after colons.")
    ] = "greedy,nearest_frontier,random,oracle",
    scene: Annotated[
        list[str] | None,
        typer.Option(help="A world file, or `room`, `room:7`, `room:0-63`; may be given more than once.", show_default="the task's"),
    ] = None,
    seeds: Seeds = 5,
    seed: Seed = 0,
    views: Views = None,
    resolution: Annotated[float | None, typer.Option(help="Side of a voxel, metres.", show_default="the task's")] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Results; episodes go to FILE.shards as they finish.", show_default="OUT/results.json"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the curves as a picture.", show_default="out/evaluate")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on after an interruption: finished episodes are kept.")] = False,
    processes: Annotated[int, typer.Option(help="Episodes at a time; results do not depend on it.", min=1)] = 1,
) -> None:
    """Compare planners: mean and 95 % confidence interval over seeds.

    One record per episode is on disk as soon as the episode is over; Ctrl-C, a crash or a power cut lose at most the
    episodes in flight, and `--resume` goes on from there. An episode that fails is reported and stops no other.

    Examples:

    - `nbv-gym evaluate --task dome_room --agents greedy,random --seeds 5 --json results.json`
    - `nbv-gym evaluate --agents greedy:metric=entropy,greedy:metric=uncertainty,oracle --scene room:7 --processes 2`
    - `nbv-gym evaluate --task six_directions --scene a.world --scene b.glb --json all.json --resume`
    - `nbv-gym evaluate --task wang2019 --agents infogain,cgain_wa --scene room:7 --resolution 0.05`
    """

    from .evaluate_command import evaluate_command
    from .terminal import terminal

    folder = out if out is not None or json_file is not None else Path("out/evaluate")
    target = json_file if json_file is not None else (folder or Path()) / "results.json"
    rows = manifest_of(task, agents, scene, range(seed, seed + seeds), views, resolution)
    if evaluate_command(rows, target, folder, resume, processes, terminal()):
        raise typer.Exit(1)


def manifest_of(
    task: str, agents: str, scenes: list[str] | None, seeds: range, views: int | None, resolution: float | None = None
) -> list[Row]:
    from .manifest import grid

    tasks, planners = split(task), split(agents)
    if not tasks or not planners:
        raise ValueError("name at least one task and one agent")
    return grid(tasks, planners, scenes or [None], seeds, views, resolution)


def split(text: str) -> list[str]:
    """Names between commas, each once."""
    return list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


@app.command()
@clear_errors
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and smaller cases, under two minutes.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write figures and ratios to this file.")] = None,
    seed: Seed = 0,
) -> None:
    """Measure speed: environment, rendering, map, gains; and peers where they are installed.

    Peers (`pip install nbv-gym[bench]`) are measured in turns with this package, so that a busy machine slows both;
    a ratio is the median over the turns.

    Examples:

    - `nbv-gym bench`
    - `nbv-gym bench --quick --json bench.json`
    """
    from .benchmark import bench as run_bench
    from .terminal import terminal

    run_bench(quick, json_file, seed, terminal())


@app.command()
@clear_errors
def view(
    source: Annotated[str, typer.Argument(help="A world file, a generated scene (`room:7`), or a results file.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="The picture (.png), film (.gif) or recording (.rrd).", show_default="in out/view"),
    ] = None,
    episode: Annotated[int, typer.Option(help="Which episode of a results file, counted from 0.", min=0)] = 0,
    resolution: Annotated[float, typer.Option(help="Side of the voxels in which a scene is drawn, metres.", min=0.01)] = 0.05,
) -> None:
    """Draw a scene, or play an episode again.

    A scene becomes a picture: an oblique view without ceilings, a plan, and depth images from its start positions. An
    episode of a results file is run again from its recorded actions and filmed, or recorded for the Rerun viewer.

    Examples:

    - `nbv-gym view house.world --out house.png`
    - `nbv-gym view out/demo/room/results.json --episode 2 --out greedy.gif`
    """
    from .terminal import terminal
    from .view_command import view_command

    view_command(source, out, episode, resolution, terminal())


def main() -> None:
    """Entry point of the console script: `--debug` may stand anywhere."""
    arguments = sys.argv[1:]
    if "--debug" in arguments:
        arguments = ["--debug", *(a for a in arguments if a != "--debug")]
    app(args=arguments, prog_name="nbv-gym")
