"""Finished episodes on disk: append-only JSON lines, one file per writer, safe against being killed.

A record is written whole, flushed and synchronised before the next episode begins, so that `kill -9` or a full disk
loses at most the episode in flight. A writer never appends to a file of an earlier run, where a torn line may be.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO


class ShardWriter:
    """Appends records to a new file in `folder`."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        number = 0
        while True:
            path = folder / f"episodes-{os.getpid()}-{number:03d}.jsonl"
            try:
                # "x" fails if the file exists: two writers never share one.
                self._file: TextIO = path.open("x", encoding="utf-8")
                break
            except FileExistsError:
                number += 1
        self.path = path

    def append(self, record: dict[str, Any]) -> None:
        self._file.write(json.dumps(record, separators=(",", ":"), allow_nan=True) + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> ShardWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()


def read_shards(folder: Path) -> Iterator[dict[str, Any]]:
    """All whole records of all shards, in the order of the file names; a torn last line is left out."""
    for path in sorted(folder.glob("episodes-*.jsonl")):
        with path.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                try:
                    record = json.loads(line)
                except json.JSONDecodeError:
                    continue
                if isinstance(record, dict) and "key" in record and line.endswith("\n"):
                    yield record


def retire(folder: Path) -> None:
    """Put the shards of an earlier run aside (`<folder>.old`), so that nothing that was computed is lost at once."""
    if not folder.exists():
        return
    old = folder.with_name(folder.name + ".old")
    if old.exists():
        for path in old.glob("episodes-*.jsonl"):
            path.unlink()
        old.rmdir()
    folder.rename(old)


@contextmanager
def claimed(folder: Path, fresh: bool) -> Iterator[None]:
    """`folder` for this process alone; a `fresh` one holds no shards.

    Raises:
        RuntimeError: Another process is at work there.
    """
    claims: list[int] = []
    try:
        claims += _claim(folder)
        if fresh and any(folder.glob("episodes-*.jsonl")):
            retire(folder)
            claims += _claim(folder)
        yield
    finally:
        for claim in claims:
            os.close(claim)


def _claim(folder: Path) -> list[int]:
    """A lock on the folder that ends with the process, however that ends."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:  # Windows has no such locks
        return []
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise RuntimeError(f"{folder}: another process is writing here; wait for its end or name another file") from None
    return [handle]


def write_whole(path: Path, text: str) -> None:
    """Replace a text file in one step: readers see the old or the new one, never a part."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file in one step, as :func:`write_whole`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with draft.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
