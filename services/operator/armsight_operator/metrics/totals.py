"""Totals that go on over restarts of whoever counts: a service that starts again counts from zero."""

from collections import OrderedDict
from collections.abc import Mapping

_INSTANCES = 4
"""Lives that are remembered: two services under one name take turns, and neither may be counted anew each time."""


class Totals:
    """The totals of one service, over all of its lives that were heard of."""

    def __init__(self) -> None:
        """All totals start at zero."""
        self._totals: dict[str, float] = {}
        self._last: OrderedDict[str, dict[str, float]] = OrderedDict()

    @property
    def totals(self) -> Mapping[str, float]:
        """Totals by name; they never fall."""
        return self._totals

    def take(self, instance: str, counted: Mapping[str, float]) -> None:
        """Takes what one life has counted since its start.

        Args:
            instance: changes with every restart.
            counted: totals since start, by name; a smaller one than before was started anew.
        """
        last = self._last.setdefault(instance, {})
        self._last.move_to_end(instance)
        while len(self._last) > _INSTANCES:
            self._last.popitem(last=False)
        for name, value in counted.items():
            before = last.get(name, 0.0)
            self._totals[name] = self._totals.get(name, 0.0) + (value - before if value >= before else value)
            last[name] = value
