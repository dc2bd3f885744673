"""Totals that health shows: what was received, refused, malformed."""

import threading


class Counters:
    """Named totals since start; safe from every thread."""

    def __init__(self) -> None:
        """All totals start at zero."""
        self._lock = threading.Lock()
        self._totals: dict[str, int] = {}

    def add(self, name: str, amount: int = 1) -> int:
        """Adds to a total and returns it."""
        with self._lock:
            total = self._totals.get(name, 0) + amount
            self._totals[name] = total
            return total

    def snapshot(self) -> dict[str, int]:
        """A copy of all totals."""
        with self._lock:
            return dict(self._totals)
