"""Checks of the bus: whether a router lets us in, and who is there. Pure: facts in, findings out."""

from dataclasses import dataclass

from armsight.topics import SERVICES
from armsight_operator.doctor.finding import Finding, broken, ok, warning


@dataclass(frozen=True, slots=True)
class Heard:
    """One service by its health; ``status`` as `armsight status` has it."""

    name: str
    status: str
    detail: str
    version: str


@dataclass(frozen=True, slots=True)
class BusFacts:
    """What came of joining the bus."""

    endpoints: tuple[str, ...]
    connected: bool
    refusal: str
    """Why a router that is there does not let us in, for a person; empty where certificates are not the reason."""
    services: tuple[Heard, ...] = ()


def router(facts: BusFacts) -> Finding:
    """Whether a router is there and lets us in."""
    where = ", ".join(facts.endpoints)
    if facts.connected:
        return ok("router", f"answers at {where}")
    if facts.refusal:
        return broken("router", f"does not let us in at {where}", facts.refusal)
    return warning("router", f"none answers at {where}", "start all with `armsight up`, or say where it is: --connect")


def services(facts: BusFacts, version: str) -> list[Finding]:
    """How everybody on the bus is; nothing without a router.

    Args:
        facts: who was heard.
        version: our own.
    """
    return [_service(one, version) for one in facts.services] if facts.connected else []


def _service(one: Heard, version: str) -> Finding:
    if one.status == "missing":
        start = f"start it: `{_command(one.name)}`" if one.name in SERVICES else "start it again"
        return warning(one.name, one.detail, start)
    if one.status != "ok":
        return warning(one.name, f"{one.status}: {one.detail}", "do what it says, or read its log")
    if one.version != version:
        return warning(one.name, f"version {one.version}, here is {version}", "run all of one version")
    return ok(one.name, f"well, version {one.version}")


def _command(name: str) -> str:
    return f"{'build/vision/' if name == 'vision' else ''}armsight-{name}"
