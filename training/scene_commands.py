"""`nbv-gym scenes`: what a world file holds, which scenes can be generated, and generating them."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .command_errors import clear_errors

if TYPE_CHECKING:
    from ..rust_env import Scene

app = typer.Typer(
    help="Look into world files; generate scenes.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def open_scene(source: str, strict: bool = False, search_paths: list[Path] | None = None, honour_up_axis: bool = False) -> Scene:
    """A scene from a file, or from `kind` or `kind:seed`."""
    from ..rust_env import SCENE_KINDS, Scene

    kind, _, seed = source.partition(":")
    if kind in SCENE_KINDS and not Path(source).exists():
        if seed and not seed.isdecimal():
            raise ValueError(f"scene {source!r}: {seed!r} is not a seed (a number >= 0)")
        return Scene.generate(kind, int(seed or 0))
    return Scene.load(source, strict=strict, search_paths=search_paths or [], honour_up_axis=honour_up_axis)


def facts(scene: Scene, seconds: float) -> dict[str, Any]:
    """What `info` prints. Bounds are without the ground plane; metres, milliseconds."""
    report = scene.report
    return {
        "name": scene.name,
        "visual": {"triangles_read": report["visual_triangles_read"], "triangles": report["visual_triangles"]},
        "collision": {"triangles_read": report["collision_triangles_read"], "triangles": report["collision_triangles"]},
        "bounds": scene.bounds.astype(float).round(4).tolist(),
        "visual_bounds": rounded(report["visual_bounds"]),
        "collision_bounds": rounded(report["collision_bounds"]),
        "floor": round(float(scene.floor), 4),
        "instances": report["instances"],
        "starts": len(scene.starts),
        "warnings": list(report["warnings"]),
        "missing": list(report["missing"]),
        "cache": report["cache"],
        "load_milliseconds": round(float(report["load_milliseconds"]), 3),
        "total_milliseconds": round(seconds * 1e3, 3),
    }


def cache_note(done: str) -> str:
    return {"": "", "read": " from the cache"}.get(done, f" (cache: {done})")


def rounded(bounds: Any) -> Any:
    return None if bounds is None else [[round(float(x), 4) for x in corner] for corner in bounds]


@app.command()
@clear_errors
def info(
    file: Annotated[str, typer.Argument(help="A world file, or a generated scene (`room:7`).", show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="A missing or broken part is an error, not a warning.")] = False,
    search: Annotated[
        list[Path] | None, typer.Option("--search", help="Folder with models for model:// URIs; may be given more than once.")
    ] = None,
    up_axis: Annotated[bool, typer.Option("--honour-up-axis", help="Turn COLLADA parts by their <up_axis>, which Gazebo ignores.")] = False,
) -> None:
    """Say what a world holds: triangles as read and after dropping duplicate and degenerate ones, bounds, faults.

    Examples:

    - `nbv-gym scenes info house/worlds/house.world`
    - `nbv-gym scenes info scan.glb --json --strict`
    """
    started = time.perf_counter()
    scene = open_scene(file, strict, search, up_axis)
    found = facts(scene, time.perf_counter() - started)
    if as_json:
        typer.echo(json.dumps(found, indent=1))
        return
    from .terminal import terminal

    console = terminal()
    console.print(f"[bold]{found['name']}[/bold]  {file}", highlight=False)
    low, high = found["bounds"]
    size = " × ".join(f"{b - a:.2f}" for a, b in zip(low, high, strict=True))
    for name, value in (
        ("size", f"{size} m, floor at {found['floor']:.3f} m"),
        ("bounds", f"{low} to {high}"),
        ("visual", "{triangles:,} triangles ({triangles_read:,} read)".format(**found["visual"])),
        ("collision", "{triangles:,} triangles ({triangles_read:,} read)".format(**found["collision"])),
        ("parts", f"{found['instances']} instances, {len(found['missing'])} missing, {len(found['warnings'])} warnings"),
        ("starts", f"{found['starts']} free start positions"),
        ("loaded in", f"{found['load_milliseconds']:.0f} ms{cache_note(found['cache'])}"),
    ):
        console.print(f"  {name:<10} {value}", highlight=False)
    for kind in ("missing", "warnings"):
        for line in found[kind]:
            console.print(f"  [yellow]{kind.rstrip('s')}[/yellow] {line}", highlight=False, markup=True)


@app.command("list")
@clear_errors
def list_kinds() -> None:
    """List the kinds of scenes that can be generated."""
    from ..rust_env import SCENE_KINDS, Scene

    for kind in SCENE_KINDS:
        scene = Scene.generate(kind, 0)
        low, high = scene.bounds
        size = " x ".join(f"{x:.1f}" for x in high - low)
        typer.echo(f"{kind:<12} {kind}:0 is {size} m, {len(scene.triangles):,} triangles")


@app.command()
@clear_errors
def generate(
    kind: Annotated[str, typer.Argument(help="One of `nbv-gym scenes list`.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="The file to write: .ply (binary) or .obj.")],
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same scene.", min=0)] = 0,
) -> None:
    """Generate a scene and write its mesh.

    Example: `nbv-gym scenes generate room --seed 7 --out room.ply`
    """
    from ..rust_env import Scene
    from .mesh_writer import write_mesh

    scene = Scene.generate(kind, seed)
    write_mesh(out, scene.triangles)
    typer.echo(f"{out}: {len(scene.triangles):,} triangles")


@app.command()
@clear_errors
def sheet(
    out: Annotated[Path, typer.Option("--out", help="The picture to write: .png or .jpg.")],
    seeds: Annotated[int, typer.Option("--seeds", help="Scenes of each kind.", min=1, max=20)] = 4,
    first: Annotated[int, typer.Option("--first", help="Seed of the first.", min=0)] = 0,
) -> None:
    """Draw a contact sheet of all kinds of generated scenes: plans from above, and a view from the inside.

    Example: `nbv-gym scenes sheet --out scenes.jpg`
    """
    from ..rust_env import SCENE_KINDS
    from .scene_sheet import save_scene_sheet

    if out.suffix.lower() not in {".png", ".jpg", ".jpeg"}:
        raise ValueError(f"--out {out}: the picture must end in .png or .jpg")
    save_scene_sheet(out, SCENE_KINDS, range(first, first + seeds))
    typer.echo(f"{out}: {len(SCENE_KINDS)} kinds, {seeds} scenes each")


@app.command()
@clear_errors
def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove all entries.")] = False,
) -> None:
    """Say where scene files are kept once they have been read, and how much is there; `NBV_GYM_CACHE` names the folder or is `off`."""
    from ..rust_env import Scene

    found = Scene.cache_info()
    if found is None:
        typer.echo("The cache is off: NBV_GYM_CACHE says so, or there is no folder for it.")
        return
    folder, entries, size = found
    if clear:
        typer.echo(f"{folder}: {Scene.clear_cache()} entries removed")
    else:
        typer.echo(f"{folder}: {entries} entries, {size / 1e6:.1f} MB")
