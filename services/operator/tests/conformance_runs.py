"""Runs of the suite on services made for the purpose: many at a time, each under a name of its own on one router."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from plain_bus import opened, router

from armsight.bus import Bus
from armsight_operator.conformance import Outcome, Result, run, suite_of

Results = dict[str, Result]
Own = Callable[[Bus], object]


def results_of(service: str, cases: Mapping[Own, Sequence[str]], at_a_time: int = 6) -> dict[Own, Results]:
    """What the suite finds of each service, asked only for the checks that are named with it; they wait mostly."""

    def one(endpoint: str, index: int, own: Own, names: Sequence[str]) -> Results:
        namespace = f"robots/own{index}"
        theirs, ours = opened(endpoint, namespace), opened(endpoint, namespace)
        with theirs.session, ours.session:
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
