"""Rates and latencies over the last answers."""

from collections import deque
from time import monotonic

import numpy as np

_WINDOW = 300
_REFRESH_S = 0.5


class Latency:
    """Time from positions received to command sent."""

    def __init__(self) -> None:
        """No answer yet."""
        self._answers: deque[tuple[float, float]] = deque(maxlen=_WINDOW)
        self._refreshed = -_REFRESH_S

    def add(self, seconds: float) -> None:
        """Counts an answer that is given now."""
        self._answers.append((monotonic(), seconds))

    def gauges(self) -> dict[str, float]:
        """Current values for health; empty where the last ones are recent enough."""
        now = monotonic()
        if now - self._refreshed < _REFRESH_S or len(self._answers) < 2:
            return {}
        self._refreshed = now
        times, seconds = np.array(self._answers).T
        return {
            "rate_hz": float((len(times) - 1) / max(times[-1] - times[0], 1e-9)),
            "latency_p50_ms": float(np.percentile(seconds, 50) * 1e3),
            "latency_p99_ms": float(np.percentile(seconds, 99) * 1e3),
        }
