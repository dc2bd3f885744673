"""Choosing how MuJoCo draws off screen: EGL where it works, else OSMesa, which needs no GPU and no display.

MuJoCo binds to one back end when it is imported, by MUJOCO_GL: :func:`choose_gl` must run before anything imports it.
"""

import logging
import os
import sys

from armsight_sim.errors import RenderError

log = logging.getLogger(__name__)

BACK_ENDS = ("egl", "osmesa")


def choose_gl() -> str:
    """Makes MuJoCo use a back end that draws here; returns its name.

    A back end that failed can't be taken out of a process again, so the process starts itself anew with the next one.

    Raises:
        RenderError: none works.
    """
    asked = os.environ.get("MUJOCO_GL")
    name = asked or BACK_ENDS[0]
    os.environ["MUJOCO_GL"] = name
    try:
        _draw_once()
    except Exception as error:
        index = BACK_ENDS.index(name) + 1 if name in BACK_ENDS else len(BACK_ENDS)
        if index == len(BACK_ENDS) or (asked and "ARMSIGHT_GL_RETRY" not in os.environ):
            raise RenderError(
                f"OpenGL back end {name} does not draw: install libegl1 or libosmesa6 ({error})"
            ) from error
        log.warning("OpenGL back end %s does not draw, trying %s", name, BACK_ENDS[index], extra={"error": str(error)})
        environment = os.environ | {"MUJOCO_GL": BACK_ENDS[index], "ARMSIGHT_GL_RETRY": "1"}
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)  # noqa: S606  (ourselves)
    return name


def draw_nothing() -> str:
    """Keeps MuJoCo from looking for OpenGL, which need not be there; returns no name."""
    os.environ["MUJOCO_GL"] = "disable"
    return ""


def _draw_once() -> None:
    import mujoco

    context = mujoco.GLContext(8, 8)
    context.make_current()
    context.free()
