"""Checks of what is installed: Python, packages, Zenoh on both sides, the services. Pure: facts in, finding out."""

from collections.abc import Mapping
from dataclasses import dataclass

from armsight_operator.doctor.finding import Finding, broken, info, ok, warning

LEAST_PYTHON = (3, 11)

_SHOWN = 4
"""Packages that are named; there may be hundreds."""


def python(version: tuple[int, int, int], executable: str) -> Finding:
    """Whether this Python is new enough."""
    found = f"{'.'.join(map(str, version))}, {executable}"
    if version < LEAST_PYTHON:
        return broken("python", found, f"install Python {'.'.join(map(str, LEAST_PYTHON))} or newer, then `make setup`")
    return ok("python", found)


def pinned_in(requirements: str) -> dict[str, str]:
    """Versions by name, of the text of requirements.txt."""
    lines = (line.partition("#")[0].partition(";")[0].strip() for line in requirements.splitlines())
    return {name.lower(): version for name, equals, version in (line.partition("==") for line in lines) if equals}


def packages(pinned: Mapping[str, str], installed: Mapping[str, str]) -> Finding:
    """Whether packages are those that everything was tested with; a build's own mark (2.6+cpu) makes no difference."""
    missing = sorted(set(pinned) - set(installed))
    if missing:
        return broken("packages", f"not installed: {_some(missing)}", "run `make setup`")
    other = [
        f"{name} {installed[name]} instead of {version}"
        for name, version in sorted(pinned.items())
        if installed[name].partition("+")[0] != version.partition("+")[0]
    ]
    if other:
        return warning("packages", _some(other), "run `make setup`")
    return ok("packages", f"all {len(pinned)} of requirements.txt, in its versions")


def needed_packages(unmet: list[str]) -> Finding:
    """The same where there is no requirements.txt: what the package `armsight-operator` itself asks for."""
    if unmet:
        return broken("packages", f"not as armsight-operator needs: {_some(unmet)}", "install armsight-operator again")
    return ok("packages", "all that armsight-operator needs; no requirements.txt here to compare with")


def zenoh(python_version: str, vision_version: str) -> Finding:
    """Whether Python and C++ speak the same Zenoh. Versions may be empty, where they can't be told."""
    if not python_version:
        return broken("zenoh", "eclipse-zenoh is not installed", "run `make setup`")
    if not vision_version:
        return info("zenoh", f"{python_version} in Python; there is no vision here to compare with")
    if python_version != vision_version:
        mend = "build vision again with `make setup`: only the same version was tested"
        return warning("zenoh", f"{python_version} in Python, {vision_version} in vision", mend)
    return ok("zenoh", f"{python_version} in Python and in vision")


@dataclass(frozen=True, slots=True)
class Answer:
    """What another program said; how it ended."""

    code: int | None
    """None: it did not end in time, or could not be started."""
    out: str = ""
    error: str = ""

    @property
    def last_line(self) -> str:
        """What it said last, for a person."""
        lines = (self.error or self.out).strip().splitlines()
        return lines[-1][:200] if lines else "it did not end in time" if self.code is None else f"exit code {self.code}"


def vision(executable: str, missing: str, answer: Answer | None, *, expected: bool) -> Finding:
    """Whether vision is there and runs here.

    Args:
        executable: where it is; empty where it is not.
        missing: why not.
        answer: to --help.
        expected: whether it should be here, as in a source tree; the operator's image has none.
    """
    if answer is None and not expected:
        return info("vision", "vision is not installed here", "only where vision runs it is needed")
    if answer is None:
        return broken("vision", missing, "run `make setup`, or say where it is with ARMSIGHT_VISION")
    if answer.code != 0:
        return broken("vision", f"{executable} does not run: {answer.last_line}", "build it again with `make setup`")
    return ok("vision", executable)


def gl(answer: Answer | None) -> Finding:
    """Whether sim can draw off screen, and by which back end. No answer: sim is not installed here."""
    if answer is None:
        return info("graphics", "sim is not installed here", "only where sim runs it is needed")
    name = answer.out.strip()
    if answer.code == 0 and name:
        return ok("graphics", f"sim draws by {name}")
    return broken("graphics", f"sim can't draw: {answer.last_line}", "install libegl1 or libosmesa6")


def solvers(answer: Answer | None) -> Finding:
    """Whether control's solvers are compiled for this CPU. No answer: control is not installed here.

    The answer is a line for each block: empty where it is compiled, else what is wrong.
    """
    if answer is None:
        return info("solvers", "control is not installed here", "only where control runs they are needed")
    if answer.code != 0:
        return broken("solvers", f"control can't be asked: {answer.last_line}", "run `make setup`")
    lines = [line.partition(":") for line in answer.out.splitlines() if ":" in line]
    refused = [(name, reason.strip()) for name, _, reason in lines if reason.strip()]
    if not lines:
        return broken("solvers", "control names no solver", "run `make setup`")
    if refused:
        mend = "run `make setup` on this machine: they run uncompiled, several times slower"
        return warning("solvers", f"{_some([name for name, _ in refused])} not compiled: {refused[0][1]}", mend)
    return ok("solvers", f"{len(lines)} blocks compiled for this CPU")


def _some(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
