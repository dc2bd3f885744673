"""Writes the commands' --help into docs/cli.md, below its own text: `.venv/bin/python tools/cli_docs.py`."""

from pathlib import Path

from armsight_operator.cli.reference import reference

PAGE = Path(__file__).parents[1] / "docs" / "cli.md"
BEGIN = "## Commands\n"


def page(text: str) -> str:
    """The page with what is generated made anew."""
    return f"{text.partition(BEGIN)[0]}{BEGIN}\n{reference()}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
