"""Which names from the bus become labels: few, short, of plain characters. Whatever else comes is counted."""

import re
from collections import Counter
from collections.abc import Iterable

_PLAIN = re.compile(r"[A-Za-z0-9_.-]{1,64}")


class Names:
    """Names that were let in, up to a number of them; those that were expected always have their place."""

    def __init__(self, most: int, expected: Iterable[str] = ()) -> None:
        """Lets in the expected ones, and ``most`` in all."""
        self._most = most
        self._known = set(expected)

    def admit(self, name: str) -> bool:
        """Whether a name may become a label."""
        if name in self._known:
            return True
        if len(self._known) >= self._most or not _PLAIN.fullmatch(name):
            return False
        self._known.add(name)
        return True


Ignored = Counter[str]
"""What was left out, by a reason of our own."""
