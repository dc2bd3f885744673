"""What a check found."""

from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """How bad it is."""

    OK = "ok"
    INFO = "info"
    """Neither good nor bad, or it can't be told here."""
    WARNING = "warning"
    """It runs, though not as well as it could, or something is not running now."""
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class Finding:
    """One check's result."""

    check: str
    level: Level
    found: str
    mend: str = ""
    """One sentence; empty where there is nothing to mend."""


def ok(check: str, found: str) -> Finding:
    """As it should be."""
    return Finding(check, Level.OK, found)


def info(check: str, found: str, mend: str = "") -> Finding:
    """To know."""
    return Finding(check, Level.INFO, found, mend)


def warning(check: str, found: str, mend: str) -> Finding:
    """To mend when there is time."""
    return Finding(check, Level.WARNING, found, mend)


def broken(check: str, found: str, mend: str) -> Finding:
    """To mend first."""
    return Finding(check, Level.BROKEN, found, mend)
