"""A report with pictures: one text, as Markdown beside its pictures and as one HTML file with the pictures inside."""

from __future__ import annotations

import base64
import html
import re
from pathlib import Path

from .shards import write_whole

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #22272e; max-width: 1280px; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: 13px; }
th, td { border-bottom: 1px solid #dfe3e8; padding: .3rem .6rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; }
"""


def write_report(folder: Path, title: str, text: str) -> list[Path]:
    """Write `report.md` and `report.html` into the folder in which the text's pictures (PNG) stand; returns the two paths.

    Args:
        folder: Where the pictures are that the text names, relative to it.
        title: Of the HTML page.
        text: Markdown (CommonMark with tables).

    Raises:
        OSError: A picture that the text names is missing, or a file cannot be written; an older report is left as it was.
    """
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark").enable("table").render(text)

    def inside(match: re.Match[str]) -> str:
        picture = folder / html.unescape(match.group(1))
        return f'src="data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}"'

    body = re.sub(r'src="([^":]+\.png)"', inside, body)
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{STYLE}</style>'
    page = f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n{body}</body></html>\n'
    paths = [folder / "report.md", folder / "report.html"]
    write_whole(paths[0], text)
    write_whole(paths[1], page)
    return paths
