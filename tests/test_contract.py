"""Who puts, reads, answers and asks in the code is who the contract's table says: rights are made from the table."""

import ast
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from armsight import topics
from armsight.topics import EACH, QUERIES, TOPICS

ROOT = Path(__file__).parents[1]
SERVICE = ROOT / "services" / "vision_cpp" / "src" / "service"
RECORDER = ROOT / "services" / "operator" / "armsight_operator" / "recording" / "recorder.py"
CONFORMANCE = ROOT / "services" / "operator" / "armsight_operator" / "conformance"
PLAYED = {"vision": ("sim",), "control": ("sim", "vision"), "sim": ("vision", "control")}
PYTHON = {
    "sim": "services/sim/armsight_sim",
    "control": "services/control/armsight_control",
    "camera": "services/camera/armsight_camera",
}

Uses = dict[str, set[str]]
"""Names of rows by what is done with them: publisher, subscriber, serve, query, presence."""

_ROW = {name: row.name for name, row in vars(topics).items() if isinstance(row, topics.Topic | topics.Query)}


def uses_in_python(*files: Path) -> Uses:
    """Calls of a bus's methods with a constant of `armsight.topics` as their first argument, in files and folders."""
    uses: Uses = defaultdict(set)
    for file in (file for path in files for file in (path.rglob("*.py") if path.is_dir() else [path])):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            if node.func.attr == "presence":
                uses["presence"].add("health")
            elif node.func.attr in ("publisher", "subscriber", "newest", "serve", "query") and node.args:
                first = node.args[0]
                constant = first.attr if isinstance(first, ast.Attribute) else getattr(first, "id", "")
                if constant in _ROW:
                    kind = "subscriber" if node.func.attr == "newest" else node.func.attr
                    uses[kind].add(_ROW[constant])
    return uses


def uses_in_cpp(folder: Path) -> Uses:
    """Declarations with a constant of the generated `armsight/topics.hpp`."""
    text = "\n".join(file.read_text(encoding="utf-8") for file in folder.glob("*.cpp"))
    patterns = {
        "publisher": r"declare_publisher\(\s*(?:key_for\()?topics::k(\w+)\.key",
        "subscriber": r"(?:readers_\.emplace_back|make_unique<Reader>)\(connection_, topics::k(\w+)",
        "serve": r"declare_queryable\(key_for\(topics::k(\w+)Query",
        "query": r"(?:->|\.)get\(key_for\(topics::k(\w+)Query",
        "token": r"declare_token\(key_for\(topics::k(\w+)",
    }
    return {kind: {snake(name) for name in re.findall(pattern, text)} for kind, pattern in patterns.items()}


def snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def is_one_of(role: str, who: tuple[str, ...]) -> bool:
    return role in {entry.partition("/")[0] for entry in who} or ("each" in who and role in EACH)


def uses_in_table(role: str) -> Uses:
    return {
        "publisher": {topic.name for topic in TOPICS if is_one_of(role, topic.publishers)},
        "subscriber": {topic.name for topic in TOPICS if is_one_of(role, topic.readers)},
        "serve": {query.name for query in QUERIES if is_one_of(role, query.servers)},
        "query": {query.name for query in QUERIES if is_one_of(role, query.callers)},
        "presence": {topic.name for topic in TOPICS if is_one_of(role, topic.watchers)},
    }


@pytest.mark.parametrize("service", PYTHON)
def test_python_services_do_what_the_table_says(service: str) -> None:
    own, shared = uses_in_python(ROOT / PYTHON[service]), uses_in_python(ROOT / "proto" / "armsight")
    # what every Python service does, in one place: health, and parameters for `--health`
    found = {kind: own[kind] | shared[kind] for kind in ("publisher", "subscriber", "serve", "query")}
    assert found | {"presence": own["presence"]} == uses_in_table(service)


def test_vision_does_what_the_table_says() -> None:
    found = uses_in_cpp(SERVICE)
    assert found.pop("token") == {topic.name for topic in TOPICS if topic.watchers}
    assert found | {"presence": set()} == uses_in_table("vision")


def test_operator_does_nothing_that_the_table_denies() -> None:
    own = set((ROOT / "services/operator/armsight_operator").rglob("*.py"))
    # the recorder has rights of its own, and the suite speaks for the parts that it plays: below
    own -= {RECORDER, *CONFORMANCE.rglob("*.py")}
    found, allowed = uses_in_python(*own), uses_in_table("operator")
    assert {"mode", "stop", "release", "reset"} <= found["query"]
    assert {kind: rows - allowed[kind] for kind, rows in found.items() if rows - allowed[kind]} == {}
    # `armsight topics echo KEY` takes any
    assert allowed["subscriber"] == {topic.name for topic in TOPICS}


def test_recorder_reads_everything_and_tells_of_itself_alone() -> None:
    # which keys it subscribes to is said when it is started: any
    assert uses_in_table("recorder") == {
        "publisher": {"health", "parameters"},
        "subscriber": {topic.name for topic in TOPICS},
        "serve": {"parameters", "set_parameters"},
        "query": {"parameters"},
        "presence": set(),
    }
    assert uses_in_python(RECORDER) == {}


@pytest.mark.parametrize(("judged", "played"), PLAYED.items())
def test_conformance_suite_says_what_the_parts_that_it_plays_say_and_no_more(
    judged: str, played: tuple[str, ...]
) -> None:
    # no role may do all this, so it needs a bus without certificates: nothing of the table is widened for it
    found, operator = uses_in_python(CONFORMANCE / f"{judged}.py"), uses_in_table("operator")
    said = set().union(*(uses_in_table(role)["publisher"] for role in played))
    assert found["publisher"]
    assert found["publisher"] <= said
    assert found["serve"] == set()
    assert found["subscriber"] <= operator["subscriber"]
    assert found["query"] <= operator["query"]
    shared = uses_in_python(*set(CONFORMANCE.glob("*.py")) - {CONFORMANCE / f"{each}.py" for each in PLAYED})
    assert dict(shared) == {
        "subscriber": {"health", "parameters"},
        "query": {"parameters", "set_parameters"},
    }


def test_viewer_reads_what_operator_reads_and_changes_nothing_but_a_stop() -> None:
    viewer, operator = uses_in_table("viewer"), uses_in_table("operator")
    assert viewer["subscriber"] == operator["subscriber"]
    assert viewer["publisher"] == viewer["serve"] == set()
    assert viewer["query"] == operator["query"] - {"release", "reset", "mode", "set_parameters"}


@pytest.mark.parametrize("row", [*TOPICS, *QUERIES], ids=lambda row: row.name)
def test_every_row_says_who(row: Any) -> None:
    who = (row.publishers, row.readers) if isinstance(row, topics.Topic) else (row.servers, row.callers)
    assert all(who), f"{row.name} names nobody on one of its sides: nothing would pass"
