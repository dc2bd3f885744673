"""Whether shared memory can be had here, and that a session opens where it can't."""

import json
import logging
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import zenoh

from armsight import shared_memory
from armsight.session import SessionConfig, open_session
from armsight.shared_memory import LOCK_BYTES, POOL_BYTES, SESSION_BYTES, may_lock, why_not


@pytest.fixture(autouse=True)
def _room(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which nothing is in the way, whatever this one is."""
    monkeypatch.setattr(shared_memory, "may_lock", lambda _: True)
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 64 << 20)


def test_nothing_is_in_the_way_of_who_has_room_or_wants_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_not("publish") == why_not("read") == ""
    monkeypatch.setattr(shared_memory, "may_lock", lambda _: False)
    assert why_not("off") == ""


def test_what_is_in_the_way_is_told_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: POOL_BYTES)
    assert why_not("read") == "", "who reads makes no pool"
    assert "--shm-size" in why_not("publish")
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: SESSION_BYTES - 1)
    assert "--shm-size" in why_not("read")
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: None)
    assert "can't write there" in why_not("read")
    monkeypatch.setattr(shared_memory, "may_lock", lambda _: False)
    assert "ulimit -l" in why_not("read")


def test_room_is_measured_where_there_is_any(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(shared_memory, "PLACE", tmp_path)
    assert (shared_memory.free_bytes() or 0) > 0
    monkeypatch.setattr(shared_memory, "PLACE", tmp_path / "nowhere")
    assert shared_memory.free_bytes() is None


def test_what_may_be_locked_is_the_limits_word_but_for_who_is_above_it() -> None:
    code = """if True:
        import json, resource
        import armsight.shared_memory as s
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        told = []
        for above in (False, True):
            s._has_capability = lambda _, above=above: above
            told.append([s.may_lock(65536), s.may_lock(65537)])
        print(json.dumps(told))
    """
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == [[True, False], [True, True]]
    assert may_lock(0)
    assert LOCK_BYTES > POOL_BYTES


def test_a_session_opens_without_and_says_why_once(
    endpoint: str, router: zenoh.Session, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    del router
    monkeypatch.setattr(shared_memory, "free_bytes", lambda: 0)
    with caplog.at_level(logging.WARNING):
        session = open_session(SessionConfig(endpoints=(endpoint,), shared_memory="publish"), threading.Event())
    assert session is not None
    session.close()  # type: ignore[no-untyped-call]
    said = [record.getMessage() for record in caplog.records if "no shared memory" in record.getMessage()]
    assert len(said) == 1
    assert "0 bytes free" in said[0]
