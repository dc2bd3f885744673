"""Pictures in folders: which files are taken for some, and in which order."""

from pathlib import Path

from armsight.errors import ConfigError

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm"})
"""Endings of their files, in lower case."""


def pictures_in(folder: Path) -> tuple[Path, ...]:
    """The pictures of a folder in the order of their names.

    Raises:
        ConfigError: it can't be read.
    """
    try:
        return tuple(sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()))
    except OSError as error:
        raise ConfigError(f"{folder} can't be read: {error.strerror}") from error
