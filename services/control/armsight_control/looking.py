"""The angles of one instant, found out when they are first asked for: the arm seldom waits for them."""

from collections.abc import Callable

from armsight.counters import Counters
from armsight_control.chain import Array
from armsight_control.errors import PositionsError
from armsight_control.estimators import Estimate


class Looking:
    """One look of an estimator, which is taken once; not by two threads at a time."""

    def __init__(self, look: Callable[[], tuple[Estimate, Array]], before: Estimate | None, counters: Counters) -> None:
        """Nothing is looked at yet.

        Args:
            look: gives the angles, and the tip in the base frame, metres.
            before: what is known where this instant tells nothing.
            counters: count `estimate_refused` where the arm did not wait, and the positions tell nothing.
        """
        self._look: Callable[[], tuple[Estimate, Array]] | None = look
        self._estimate, self._counters = before, counters

    def tip(self) -> Array:
        """Looks now; where the tip is, base frame, metres. To be asked first, and once.

        Raises:
            PositionsError: the positions don't tell.
        """
        look, self._look = self._look, None
        assert look is not None
        self._estimate, tip = look()
        return tip

    @property
    def estimate(self) -> Estimate | None:
        """The angles; those before where this instant tells none."""
        if self._look is not None:
            try:
                self.tip()
            except PositionsError:
                self._counters.add("estimate_refused")
        return self._estimate
