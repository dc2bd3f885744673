"""The explanation's figures and numbers are what the code gives: drawn and computed anew, and compared."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import draw
import paper

pytestmark = pytest.mark.untimed

EXPLANATION = paper.ROOT / "docs" / "explanation"
# Matplotlib makes them of every bit of a number.
_ID = re.compile(r"\bp[0-9a-f]{10}\b")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")

# Names, not quantities.
NAMES = r"[Jj]oints? \d(?:(?:, \d)* and \d)?|[Ll]inks? \d(?: and \d)?|at 0\b|near 0\b|[Aa]ngles 0\b|SafetyCode"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    draw.draw(folder)
    return folder


@pytest.mark.parametrize("name", [name for page in draw.PAGES.values() for name in page.FIGURES])
def test_figure_is_what_its_script_draws(name: str, drawn: Path) -> None:
    kept, made = (
        _ID.sub("id", (folder / f"{name}.svg").read_text(encoding="utf-8")) for folder in (paper.IMAGES, drawn)
    )
    assert _NUMBER.sub("#", kept) == _NUMBER.sub("#", made), "run `make docs-figures`"
    # a tenth of a point: other processors round otherwise
    off = [abs(float(a) - float(b)) for a, b in zip(_NUMBER.findall(kept), _NUMBER.findall(made), strict=True)]
    assert max(off) < 0.1, "run `make docs-figures`"


def test_every_figure_is_drawn_and_shown() -> None:
    kept = {file.stem for file in paper.IMAGES.iterdir()}
    assert kept == {name for page in draw.PAGES.values() for name in page.FIGURES}
    for page, module in draw.PAGES.items():
        text = (EXPLANATION / f"{page}.md").read_text(encoding="utf-8")
        assert set(re.findall(r"images/figures/([\w-]+)\.svg", text)) == set(module.FIGURES)


def prose(page: Path) -> Iterator[str]:
    """What a page says, paragraph by paragraph, without formulas, code and where its links lead."""
    text = re.sub(r"^\$\$\n.*?^\$\$$|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    yield from (" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


@pytest.mark.parametrize("page", sorted(EXPLANATION.glob("*.md")), ids=lambda page: page.stem)
def test_every_number_of_the_explanation_is_what_the_code_gives(page: Path) -> None:
    text = "\n".join(prose(page))
    for fact in draw.PAGES[page.stem].facts():
        assert fact in text, f"the page does not say {fact!r} (any more)"
        text = text.replace(fact, "")
    left = re.sub(NAMES, "", re.sub(r"\$[^$\n]*\$", "", text))
    assert re.findall(r".{0,30}\d.{0,20}", left) == [], "numbers that no code is asked about"
