"""Errors of the camera service."""

from armsight.errors import ArmsightError


class CameraError(ArmsightError):
    """Base of the camera service's own errors."""


class SourceError(CameraError):
    """A source that can't be opened now: it may be later."""


class SizeError(CameraError):
    """A source whose pictures have another size than the one that was calibrated."""
