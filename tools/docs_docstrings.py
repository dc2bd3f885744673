"""Docstrings are written in Sphinx' roles; the site is Markdown. This griffe extension turns the few we use."""

import re
import textwrap
from typing import Any

import griffe

_INLINE_MATH = re.compile(r":math:`([^`]*)`")
_ROLE = re.compile(r":(?:func|class|meth|mod|attr|data):`(~?)\.*([^`]*)`")
_BLOCK_MATH = re.compile(r"^( *)\.\. math::(.*\n(?:(?:\1 +.*)?\n)*)", re.MULTILINE)
_LITERAL = re.compile(r"``([^`]+)``")


class Markdown(griffe.Extension):
    """Rewrites every docstring before it is parsed."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Of any module, class, function or attribute."""
        del kwargs
        if obj.docstring is not None:
            obj.docstring.value = markdown(obj.docstring.value)


def markdown(text: str) -> str:
    """A docstring's text in Markdown."""
    text = _BLOCK_MATH.sub(_block, f"{text}\n")
    text = _INLINE_MATH.sub(r"$\1$", text)
    text = _ROLE.sub(lambda role: f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`", text)
    return _LITERAL.sub(r"`\1`", text).rstrip("\n")


def _block(found: re.Match[str]) -> str:
    indent, body = found.groups()
    first, _, rest = body.partition("\n")
    formula = f"{first.strip()}\n{textwrap.dedent(rest)}".strip()
    if "&" in formula:
        formula = f"\\begin{{aligned}}\n{formula}\n\\end{{aligned}}"
    lines = ["", "$$", *filter(str.strip, formula.splitlines()), "$$", "", ""]
    return "\n".join(f"{indent}{line}" if line else "" for line in lines)
