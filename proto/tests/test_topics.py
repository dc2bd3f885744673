import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from armsight import topics
from armsight.topics import TOPICS

PROTO = Path(__file__).parents[1]


def test_every_row_of_the_table_has_its_constant() -> None:
    table = tomllib.loads((PROTO / "armsight" / "topics.toml").read_text(encoding="utf-8"))
    assert {row["name"] for row in table["topic"]} == {topic.name for topic in TOPICS}
    queries = {q.name for q in vars(topics).values() if isinstance(q, topics.Query)}
    assert {row["name"] for row in table["query"]} == queries


def test_name_in_a_key_is_found_and_filled() -> None:
    assert topics.CAMERA_IMAGE.key_for("left") == "camera/left/image"
    assert topics.CAMERA_IMAGE.name_in("robots/arm/camera/left/image") == "left"
    assert topics.CLOCK.name_in("clock") == ""
    with pytest.raises(ValueError, match="needs name"):
        topics.CAMERA_IMAGE.key_for()
    with pytest.raises(ValueError, match="takes no name"):
        topics.CLOCK.key_for("left")


def test_header_for_cpp_carries_the_same_keys_and_qos(tmp_path: Path) -> None:
    header = tmp_path / "topics.hpp"
    generator = PROTO / "tools" / "generate_topics_header.py"
    subprocess.run([sys.executable, generator, PROTO / "armsight" / "topics.toml", header], check=True)
    text = header.read_text(encoding="utf-8")
    for topic in TOPICS:
        assert f'"{topic.key}"' in text
        assert topics.encoding_of(topic.message) in text
