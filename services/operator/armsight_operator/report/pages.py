"""A report's files: Markdown, JSON, and one HTML page that has everything in it."""

import base64
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; display: block; overflow-x: auto; }
th, td { border: 1px solid #ccc; padding: .25rem .6rem; text-align: left; }
th { background: #f3f3f3; }
img { max-width: 100%; }
"""


def write(markdown: str, figures: Mapping[str, Any], folder: Path) -> None:
    """Writes ``report.md``, ``summary.json`` and ``report.html``; the pictures are in the folder already."""
    (folder / "report.md").write_text(markdown, encoding="utf-8")
    (folder / "summary.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    (folder / "report.html").write_text(to_html(markdown, folder), encoding="utf-8")


def to_html(markdown: str, folder: Path) -> str:
    """A page that needs no other file: pictures that the Markdown names are in it."""
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(markdown)

    def inline(found: re.Match[str]) -> str:
        data = base64.b64encode((folder / found[1]).read_bytes()).decode("ascii")
        return f'src="data:image/png;base64,{data}"'

    body = re.sub(r'src="([^":]+\.png)"', inline, body)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width">\n<title>armsight report</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )
