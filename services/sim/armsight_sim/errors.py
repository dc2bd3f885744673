"""Errors of the simulation."""

from armsight.errors import ArmsightError


class SimError(ArmsightError):
    """Base of the simulation's own errors."""


class ModelError(SimError):
    """The MuJoCo model does not follow the conventions that its first comment lists."""


class PoseError(SimError):
    """A pose that the arm does not have: unknown joint, not finite, beyond a limit."""


class RenderError(SimError):
    """No OpenGL back end can draw off screen here."""
