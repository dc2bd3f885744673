"""`armsight describe`: all that is wrong with a model at once, and what it describes where nothing is."""

import json
from pathlib import Path

import pytest

from armsight_operator.cli.app import REFUSED, USAGE, main

FIVE = Path(__file__).parents[2] / "sim" / "armsight_sim" / "models" / "five.xml"


def test_describes_an_arm_that_can_be_used(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["describe", str(FIVE)])
    assert not ended.value.code
    out = capsys.readouterr().out
    assert "five: can be used" in out
    assert all(name in out for name in ("yaw", "twist", "orange", "(tip)", "1024 x 768"))


def test_json_has_the_description_as_protobuf_writes_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["describe", str(FIVE), "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["findings"] == []
    assert said["description"]["joints"][1]["max_speed_rad_s"] == 2.5


def test_says_everything_that_is_wrong_with_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "arm.xml"
    model.write_text(FIVE.read_text().replace(' user="2.5"', "").replace('<site name="tip"', '<site name="end"'))
    with pytest.raises(SystemExit) as ended:
        main(["describe", str(model)])
    assert ended.value.code == REFUSED
    out = capsys.readouterr().out
    assert "shoulder has no speed; say how fast" in out
    assert "there is no tip; put <site" in out
    assert "2 to mend" in out


def test_a_file_that_is_no_model_is_a_usage_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["describe", str(tmp_path / "nothing.xml")])
    assert ended.value.code == USAGE
    assert "there is no model" in capsys.readouterr().err
