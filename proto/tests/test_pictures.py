from pathlib import Path

import pytest

from armsight.errors import ConfigError
from armsight.pictures import pictures_in


def test_pictures_come_in_the_order_of_their_names_and_nothing_else_does(tmp_path: Path) -> None:
    for name in ("b.PNG", "a.jpg", "ü c.webp", "notes.txt", "calibration.json"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder.png").mkdir()
    assert [file.name for file in pictures_in(tmp_path)] == ["a.jpg", "b.PNG", "ü c.webp"]


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="can't be read: No such file"):
        pictures_in(tmp_path / "nowhere")
