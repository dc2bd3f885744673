"""How long to wait before a process that died is started again."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Backoff:
    """Doubling delays, from the first again once a process has lived long enough to count as healthy."""

    first_s: float = 0.5
    factor: float = 2.0
    longest_s: float = 10.0
    healthy_after_s: float = 30.0

    def delay(self, previous_s: float | None, lived_s: float) -> float:
        """Seconds to wait before the next start.

        Args:
            previous_s: what was waited before the life that just ended; nothing for the first life.
            lived_s: how long that life was.
        """
        if previous_s is None or lived_s >= self.healthy_after_s:
            return self.first_s
        return min(previous_s * self.factor, self.longest_s)
