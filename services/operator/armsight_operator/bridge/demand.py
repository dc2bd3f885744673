"""Which keys of the bus are wanted by whoever looks: the first who does begins it, the last who leaves ends it."""

import threading
from collections import Counter
from collections.abc import Callable

Begin = Callable[[str], Callable[[], None]]
"""Listens to a key; returns what ends that."""


class Demand:
    """Counts, for each key, who wants it; safe from every thread, and never calls ``begin`` from that of the caller."""

    def __init__(self, begin: Begin) -> None:
        """Nobody wants anything yet.

        Args:
            begin: called by a thread of this object's own.
        """
        self._begin = begin
        self._wanted: Counter[str] = Counter()
        self._ends: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._follow, name="demand", daemon=True)
        self._thread.start()

    def add(self, key: str) -> None:
        """One more wants it."""
        with self._changed:
            self._wanted[key] += 1
            self._changed.notify_all()

    def remove(self, key: str) -> None:
        """One less wants it."""
        with self._changed:
            self._wanted[key] = max(0, self._wanted[key] - 1)
            self._changed.notify_all()

    def close(self) -> None:
        """Ends everything."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(timeout=1.0)

    def _follow(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wrong())
                to_end, to_begin = self._changes()
            for key in to_end:
                self._ends.pop(key)()
            for key in to_begin:
                self._ends[key] = self._begin(key)
            if self._closed and not self._ends:
                return

    def _changes(self) -> tuple[list[str], list[str]]:
        wanted = set() if self._closed else {key for key, count in self._wanted.items() if count}
        return sorted(set(self._ends) - wanted), sorted(wanted - set(self._ends))

    def _wrong(self) -> bool:
        return any(self._changes())
