"""What a user sees when a command cannot do its work: one line, or the whole traceback with `--debug`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import typer

P = ParamSpec("P")
R = TypeVar("R")
_debug = False


def set_debug(debug: bool) -> None:
    global _debug
    _debug = debug


def clear_errors(command: Callable[P, R]) -> Callable[P, R]:
    """Exit code 2 and one line for what a user can put right, 130 for Ctrl-C."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except KeyboardInterrupt:
            typer.echo("interrupted; what was finished is kept", err=True)
            raise typer.Exit(130) from None
        except (typer.Exit, typer.Abort):
            raise
        except (ValueError, TypeError, OSError, KeyError, ImportError, RuntimeError) as error:
            if _debug:
                raise
            typer.echo(f"error: {one_line(error)}", err=True)
            raise typer.Exit(2) from None

    return run


def one_line(error: BaseException) -> str:
    """The message without line breaks; an OSError's with its file."""
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, KeyError):
        return f"missing key {text}"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return text
