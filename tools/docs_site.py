"""What MkDocs does not do by itself for the site: pages from elsewhere in the repository, their links, formulas.

- README.md, ARCHITECTURE.md and the Denavit-Hartenberg table stay where they are and are pages of the site as well.
- Links are written for who reads the repository. Those to files that are no pages lead to copies in ``files/``.
- Formulas become MathML here, which every browser draws by itself: no script, nothing to fetch, and one package that is
  pure Python (latex2mathml) in place of MathJax' megabytes.
"""

import html
import posixpath
import re
from pathlib import Path
from xml.etree import ElementTree

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
DOCS = "docs/"
FILES = "files/"

# File of the repository → page of the site.
ELSEWHERE = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "services/control/docs/denavit-hartenberg.md": "denavit-hartenberg.md",
}
# Linked folders and files whose place on the site is a page about them.
STANDS_FOR = {"proto": "messages.md", "proto/armsight/topics.toml": "keys.md", "examples": "own-part.md"}

_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)#\s]+)(#[^)\s]*)?(\))")
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>', re.DOTALL)
_DELIMITERS = ("\\(", "\\)", "\\[", "\\]")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages from elsewhere, and the files that any page links to."""
    for source, place in ELSEWHERE.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text(encoding="utf-8")))
    for page in list(files.documentation_pages()):
        for link in _LINK.finditer(page.content_string):
            found = _in_repository(page.src_uri, link[2])
            uri = _uri(found)
            if uri.startswith(FILES) and (ROOT / found).is_file() and files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(ROOT / found)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links of the repository into links of the site."""
    del config, files
    uri = page.file.src_uri

    def mended(link: re.Match[str]) -> str:
        before, target, anchor, after = link.groups(default="")
        if ":" in target or target.startswith("/"):
            return link[0]
        new = posixpath.relpath(_uri(_in_repository(uri, target)), posixpath.dirname(uri) or ".")
        return f"{before}{new}{anchor}{after}"

    return _LINK.sub(mended, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Draws the formulas."""
    del config, files
    return _FORMULA.sub(lambda found: _mathml(found[2], found[1] == "div", page.file.src_uri), html)


def _in_repository(page: str, target: str) -> str:
    """What a link on a page of the site names, as a path in the repository."""
    at = next((source for source, elsewhere in ELSEWHERE.items() if elsewhere == page), DOCS + page)
    return posixpath.normpath(posixpath.join(posixpath.dirname(at), target))


def _uri(path: str) -> str:
    """Where a file of the repository is on the site."""
    if path in ELSEWHERE or path in STANDS_FOR:
        return ELSEWHERE.get(path) or STANDS_FOR[path]
    return path.removeprefix(DOCS) if path.startswith(DOCS) else FILES + path


def _mathml(formula: str, alone: bool, page: str) -> str:
    """A formula as MathML.

    Raises:
        PluginError: it holds what the converter does not know and would leave out or print as it is.
    """
    latex = html.unescape(formula).strip()
    for delimiter in _DELIMITERS:
        latex = latex.removeprefix(delimiter).removesuffix(delimiter)
    # the converter lays arrays out in columns, and knows aligned equations by no other name
    latex = latex.replace(r"\begin{aligned}", r"\begin{array}{rl}").replace(r"\end{aligned}", r"\end{array}")
    made = convert(latex.strip(), display="block" if alone else "inline")
    try:
        tree = ElementTree.fromstring(made)  # noqa: S314  our own output
    except ElementTree.ParseError as error:
        raise PluginError(f"{page}: no MathML from {latex!r}: {error}") from error
    wrong = [element.text for element in tree.iter() if element.text and ("\\" in element.text or "&" in element.text)]
    empty = [element for element in tree.iter() if element.tag.endswith(("}mo", "}mi")) and not element.text]
    if wrong or empty:
        raise PluginError(f"{page}: the converter does not know all of {latex!r}: {wrong or 'something is left out'}")
    return made
