"""Which keys of the bus somebody means by patterns such as ``joints/*`` and ``camera/1/image``."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import zenoh

from armsight.errors import ConfigError
from armsight.topics import TOPICS, Topic


@dataclass(frozen=True, slots=True)
class Selection:
    """Keys by patterns of Zenoh's: ``*`` stands for one chunk, ``**`` for any number of them."""

    wanted: tuple[zenoh.KeyExpr, ...]
    unwanted: tuple[zenoh.KeyExpr, ...] = ()

    def has(self, key: str) -> bool:
        """Whether a key, without patterns in it, is meant."""
        expression = zenoh.KeyExpr(key)
        return any(p.includes(expression) for p in self.wanted) and not any(
            p.includes(expression) for p in self.unwanted
        )

    def topics(self, topics: Iterable[Topic[Any]] = TOPICS) -> list[tuple[Topic[Any], str | None]]:
        """Rows of the table that have such keys, and the name to subscribe to: ``*``, or the one meant."""
        return [(topic, name) for topic in topics for name in self._names(topic)]

    def _names(self, topic: Topic[Any]) -> list[str | None]:
        wild = topic.key.replace("{name}", "*")
        if any(pattern.includes(zenoh.KeyExpr(wild)) for pattern in self.unwanted):
            return []
        meant = [pattern for pattern in self.wanted if pattern.intersects(zenoh.KeyExpr(wild))]
        if not meant:
            return []
        if wild == topic.key:
            return [None]
        names = [self._only_name(topic, pattern) for pattern in meant]
        return ["*"] if "*" in names else sorted(set(names))  # type: ignore[return-value]

    @staticmethod
    def _only_name(topic: Topic[Any], pattern: zenoh.KeyExpr) -> str:
        parts = str(pattern).split("/")
        place = topic.key.split("/")
        if len(parts) != len(place):  # ** stands for the name
            return "*"
        name = parts[place.index("{name}")]
        return "*" if set(name) & set("*$") else name


def select(wanted: Sequence[str] = (), unwanted: Sequence[str] = ()) -> Selection:
    """What patterns stand for; none wanted: everything but what is unwanted.

    Raises:
        ConfigError: a pattern that is none, or that no key of the bus fits.
    """
    return Selection(tuple(map(_pattern, wanted)) or (zenoh.KeyExpr("**"),), tuple(map(_pattern, unwanted)))


def _pattern(text: str) -> zenoh.KeyExpr:
    try:
        pattern = zenoh.KeyExpr.autocanonize(text.strip("/"))
    except zenoh.ZError as error:
        raise ConfigError(f"{text!r} is not a key such as joints/positions or 'camera/*/image'") from error
    if not any(pattern.intersects(zenoh.KeyExpr(topic.key.replace("{name}", "*"))) for topic in TOPICS):
        raise ConfigError(f"no key {text!r}: see `armsight topics list`")
    return pattern
