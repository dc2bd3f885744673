"""Runs of the suite on services made for the purpose: many at a time, each under a name of its own on one router."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from armsight.bus import Bus
from armsight.session import SessionConfig, open_session
from armsight_operator.conformance import Outcome, Result, run, suite_of
from armsight_operator.stack import free_port

Results = dict[str, Result]
Own = Callable[[Bus], object]


@contextmanager
def router() -> Iterator[str]:
    """A router's endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = SessionConfig(mode="router", endpoints=(endpoint,), namespace="", shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    with session:
        yield endpoint


@contextmanager
def place(endpoint: str, namespace: str) -> Iterator[Bus]:
    """A bus, as every service opens it."""
    config = SessionConfig(endpoints=(endpoint,), namespace=namespace, shared_memory="off")
    session = open_session(config, threading.Event())
    assert session is not None
    with session:
        yield Bus(session)


def results_of(service: str, cases: Mapping[Own, Sequence[str]], at_a_time: int = 6) -> dict[Own, Results]:
    """What the suite finds of each service, asked only for the checks that are named with it; they wait mostly."""

    def one(endpoint: str, index: int, own: Own, names: Sequence[str]) -> Results:
        namespace = f"robots/own{index}"
        with place(endpoint, namespace) as theirs, place(endpoint, namespace) as ours:
            kept = own(theirs)
            found = {result.name: result for result in run(ours, suite_of(service), names)}
            del kept
            return found

    with router() as endpoint, ThreadPoolExecutor(at_a_time) as pool:
        jobs = {own: pool.submit(one, endpoint, index, own, names) for index, (own, names) in enumerate(cases.items())}
        return {own: job.result() for own, job in jobs.items()}


def failed(found: Results) -> set[str]:
    """Names of the checks that failed."""
    return {name for name, result in found.items() if result.outcome is Outcome.FAILED}
