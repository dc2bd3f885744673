"""Choosing how MuJoCo draws off screen: EGL where it works, else OSMesa, which needs no GPU and no display.

MuJoCo binds to one back end when it is imported, by MUJOCO_GL: :func:`choose_gl` must run before anything imports it.
"""

import logging
import os
import sys
from dataclasses import dataclass

from armsight_sim.errors import RenderError

log = logging.getLogger(__name__)

BACK_ENDS = ("egl", "osmesa")
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "software")


@dataclass(frozen=True, slots=True)
class BackEnd:
    """What draws."""

    name: str
    """As MUJOCO_GL has it."""
    renderer: str
    """As OpenGL says it of itself."""

    @property
    def is_software(self) -> bool:
        """Whether the processor draws."""
        return any(word in self.renderer.lower() for word in _SOFTWARE)

    def __str__(self) -> str:
        """For a person."""
        return f"{self.name}, {self.renderer}"


def choose_gl() -> BackEnd:
    """Makes MuJoCo use a back end that draws here.

    A back end that failed can't be taken out of a process again, so the process starts itself anew with the next one.

    Raises:
        RenderError: none works.
    """
    asked = os.environ.get("MUJOCO_GL")
    name = asked or BACK_ENDS[0]
    os.environ["MUJOCO_GL"] = name
    try:
        return BackEnd(name, _draw_once())
    except Exception as error:
        index = BACK_ENDS.index(name) + 1 if name in BACK_ENDS else len(BACK_ENDS)
        if index == len(BACK_ENDS) or (asked and "ARMSIGHT_GL_RETRY" not in os.environ):
            raise RenderError(
                f"OpenGL back end {name} does not draw: install libegl1 or libosmesa6 ({error})"
            ) from error
        log.warning("OpenGL back end %s does not draw, trying %s", name, BACK_ENDS[index], extra={"error": str(error)})
        environment = os.environ | {"MUJOCO_GL": BACK_ENDS[index], "ARMSIGHT_GL_RETRY": "1"}
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)  # noqa: S606  (ourselves)


def draw_nothing() -> None:
    """Keeps MuJoCo from looking for OpenGL, which need not be there."""
    os.environ["MUJOCO_GL"] = "disable"


def _draw_once() -> str:
    import mujoco
    from OpenGL import GL

    context = mujoco.GLContext(8, 8)
    context.make_current()
    renderer = GL.glGetString(GL.GL_RENDERER).decode(errors="replace")
    context.free()
    return str(renderer)
