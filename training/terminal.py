"""How commands talk: a console wide enough for tables, and the progress bar of all long work."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

#: Columns of tables that go to a file or a pipe.
PIPE_WIDTH = 118


def terminal() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=PIPE_WIDTH)


def bar(console: Console) -> Progress:
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console)
