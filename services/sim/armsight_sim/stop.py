"""The stop's state, per source: who stopped the arm, who promised a heartbeat.

Silence is judged on the receiver's monotonic clock: a source's own clock may be what failed.
"""

from dataclasses import dataclass, replace

from armsight.times import from_duration, to_duration, to_timestamp
from armsight.v1.safety_pb2 import (
    STOP_ACTION_HEARTBEAT,
    STOP_ACTION_RELEASE,
    STOP_ACTION_STOP,
    StopRequest,
    StopSource,
    StopState,
)
from armsight_sim.errors import SimError

MAX_SOURCES = 64
_NAME_LENGTH = 64


class StopRequestError(SimError):
    """A stop request that makes no sense."""


@dataclass(frozen=True, slots=True)
class _Source:
    stopped: bool
    reason: str
    since_ns: int
    heartbeat_s: float
    heard_s: float


class StopSources:
    """Starts released; a source that stopped stays stopped until it is released by name."""

    def __init__(self) -> None:
        """No source yet."""
        self._sources: dict[str, _Source] = {}

    @property
    def stopped(self) -> bool:
        """Whether any source holds the arm."""
        return any(source.stopped for source in self._sources.values())

    def handle(self, request: StopRequest, monotonic_s: float, wall_ns: int) -> bool:
        """Takes one request; returns whether the state changed.

        Raises:
            StopRequestError: no source, no action, a heartbeat that is not positive.
        """
        name = request.source
        if not name or len(name) > _NAME_LENGTH:
            raise StopRequestError(f"a source has a name of 1 to {_NAME_LENGTH} characters; got {len(name)}")
        heartbeat_s = from_duration(request.heartbeat)
        if heartbeat_s < 0:
            raise StopRequestError(f"a heartbeat of {heartbeat_s:g} s makes no sense")
        known = self._sources.get(name)
        if known is None and len(self._sources) >= MAX_SOURCES:
            raise StopRequestError(f"more than {MAX_SOURCES} sources: release some first")
        if request.action == STOP_ACTION_STOP:
            self._sources[name] = _Source(True, request.reason[:200], wall_ns, heartbeat_s, monotonic_s)
        elif request.action == STOP_ACTION_RELEASE:
            if known is None:
                held = ", ".join(sorted(n for n, s in self._sources.items() if s.stopped)) or "nobody"
                raise StopRequestError(f"{name!r} has not stopped the arm; stopped by: {held}")
            if heartbeat_s == 0.0:
                del self._sources[name]
            else:
                self._sources[name] = _Source(False, "", wall_ns, heartbeat_s, monotonic_s)
        elif request.action == STOP_ACTION_HEARTBEAT:
            kept = heartbeat_s or (known.heartbeat_s if known is not None else 0.0)
            if kept == 0.0:
                raise StopRequestError(f"{name!r} never said how often its heartbeat comes: set `heartbeat`")
            base = known or _Source(False, "", wall_ns, kept, monotonic_s)
            self._sources[name] = replace(base, heartbeat_s=kept, heard_s=monotonic_s)
            return known is None
        else:
            raise StopRequestError("the action must be STOP, RELEASE or HEARTBEAT")
        return True

    def check_heartbeats(self, monotonic_s: float, wall_ns: int) -> bool:
        """Stops for every source that fell silent; returns whether the state changed."""
        silent = {
            name: source
            for name, source in self._sources.items()
            if source.heartbeat_s > 0.0 and not source.stopped and monotonic_s - source.heard_s > source.heartbeat_s
        }
        for name, source in silent.items():
            reason = f"no heartbeat for {source.heartbeat_s:g} s"
            self._sources[name] = replace(source, stopped=True, reason=reason, since_ns=wall_ns)
        return bool(silent)

    def message(self) -> StopState:
        """The state as it goes on the bus."""
        sources = [
            StopSource(
                name=name,
                stopped=source.stopped,
                reason=source.reason,
                since=to_timestamp(source.since_ns),
                heartbeat=to_duration(source.heartbeat_s) if source.heartbeat_s > 0.0 else None,
            )
            for name, source in sorted(self._sources.items())
        ]
        return StopState(stopped=self.stopped, sources=sources)
