"""Parameters: typed and bounded whatever arrives, all set or none, told to whoever listens."""

import math
from collections.abc import Mapping

import pytest
from google.protobuf.empty_pb2 import Empty
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ArmsightError, ParameterError, RefusedError
from armsight.parameters import Tunable, Tunables, Value, value_message
from armsight.service import serve_parameters
from armsight.v1.parameters_pb2 import Parameters, ParameterValue, SetParametersRequest

SPEED = Tunable("speed", "share of the joints' speed", 0.3, "", 0.01, 0.5)
STEPS = Tunable("steps", "of a descent", 10, "", 1, 100)
AVOID = Tunable("avoid", "keep off the box", False)
SOLVER = Tunable("solver", "of inverse kinematics", "torch", choices=("torch", "closed-form"))
ALL = (SPEED, STEPS, AVOID, SOLVER)


class Kept:
    """Tunables with what was applied and published."""

    def __init__(self, refusal: str = "") -> None:
        self.applied: list[dict[str, Value]] = []
        self.published: list[Parameters] = []
        self.refusal = refusal
        self.tunables = Tunables(self.published.append)
        self.tunables.declare(ALL, self._apply)

    def _apply(self, values: Mapping[str, Value]) -> None:
        if self.refusal:
            raise ArmsightError(self.refusal)
        self.applied.append(dict(values))

    def in_force(self) -> dict[str, ParameterValue]:
        return {one.name: one.value for one in self.tunables.messages()}


def test_all_values_are_set_or_none() -> None:
    kept = Kept()
    kept.tunables.set({"speed": ParameterValue(number=0.1), "solver": ParameterValue(text="closed-form")})
    (applied,) = kept.applied
    assert applied == {"speed": 0.1, "steps": 10, "avoid": False, "solver": "closed-form"}
    assert len(kept.published) == 2, "once when declared, once when changed"
    assert {one.name: one.value for one in kept.published[-1].parameters} == kept.in_force()

    with pytest.raises(ParameterError, match=r"speed is a number within 0.01 to 0.5, not 0.6"):
        kept.tunables.set({"avoid": ParameterValue(flag=True), "speed": ParameterValue(number=0.6)})
    assert kept.in_force()["avoid"] == ParameterValue(flag=False)
    assert len(kept.applied) == 1
    assert len(kept.published) == 2


def test_what_the_service_itself_refuses_stays_as_it_was() -> None:
    kept = Kept("not while the arm moves")
    with pytest.raises(ArmsightError, match="not while the arm moves"):
        kept.tunables.set({"steps": ParameterValue(whole=20)})
    assert kept.in_force()["steps"] == ParameterValue(whole=10)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("speed", ParameterValue(number=math.nan), "within 0.01 to 0.5, not nan"),
        ("speed", ParameterValue(text="fast"), "speed is a number within"),
        ("speed", ParameterValue(flag=True), "speed is a number within"),
        ("speed", ParameterValue(), "speed is a number within"),
        ("steps", ParameterValue(number=5.0), "steps is a whole number within 1 to 100"),
        ("steps", ParameterValue(whole=101), "steps is a whole number within 1 to 100, not 101"),
        ("avoid", ParameterValue(whole=1), "avoid is true or false"),
        ("solver", ParameterValue(text="magic"), "solver is one of torch, closed-form"),
        ("colour", ParameterValue(text="red"), "there is no parameter 'colour' here: speed, steps, avoid, solver"),
    ],
)
def test_a_refusal_says_what_may_be(name: str, value: ParameterValue, text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        Kept().tunables.set({name: value})


def test_a_whole_number_will_do_for_a_number() -> None:
    wide = Tunable("gain", "of the correction", 0.5, "", 0.0, 10.0)
    assert wide.checked(ParameterValue(whole=2)) == 2.0


VALUES = st.one_of(
    st.builds(ParameterValue),
    st.floats().map(lambda number: ParameterValue(number=number)),
    st.integers(-(2**63), 2**63 - 1).map(lambda whole: ParameterValue(whole=whole)),
    st.booleans().map(lambda flag: ParameterValue(flag=flag)),
    st.sampled_from(["torch", "closed-form", "", "x"]).map(lambda text: ParameterValue(text=text)),
)


NAMES = st.sampled_from([*(one.name for one in ALL), "other"])


@settings(deadline=None)
@given(st.lists(st.dictionaries(NAMES, VALUES, max_size=3), max_size=8))
def test_whatever_arrives_what_is_in_force_is_within_its_bounds(requests: list[dict[str, ParameterValue]]) -> None:
    kept = Kept()
    for request in requests:
        before = kept.in_force()
        try:
            kept.tunables.set(request)
        except ParameterError:
            assert kept.in_force() == before
        for spec in ALL:
            assert value_message(spec.checked(kept.in_force()[spec.name])) == kept.in_force()[spec.name]


@pytest.mark.parametrize(
    "wrong",
    [
        {"value": 2.0, "least": 0.0, "most": 1.0},
        {"value": 2.0},
        {"value": "green", "choices": ("red", "blue")},
    ],
)
def test_a_parameter_without_bounds_or_outside_of_them_is_a_mistake_of_ours(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="bounds"):
        Tunable("name", "", **wrong)  # type: ignore[arg-type]


def test_over_the_bus_they_are_asked_set_and_told(two_buses: tuple[Bus, Bus]) -> None:
    here, there = two_buses
    tunables = serve_parameters("control", here, {"mode": "hold"})
    tunables.declare(ALL, lambda _: None)
    told = there.subscriber(topics.PARAMETERS, "*")
    first = told.recv(5.0)
    assert first is not None
    assert first.name == "control"
    answer = there.query(topics.ASK_PARAMETERS, Empty(), "control")
    assert answer.json == '{"mode": "hold"}'
    assert list(answer.parameters) == list(first.message.parameters)

    request = SetParametersRequest(values={"steps": ParameterValue(whole=20)})
    changed = there.query(topics.SET_PARAMETERS, request, "control")
    second = told.recv(5.0)
    assert second is not None
    assert list(second.message.parameters) == list(changed.parameters)
    assert {one.name: one.value for one in changed.parameters}["steps"] == ParameterValue(whole=20)
    with pytest.raises(RefusedError, match="there is no parameter 'x' here"):
        there.query(topics.SET_PARAMETERS, SetParametersRequest(values={"x": ParameterValue(flag=True)}), "control")
    assert here.counters.snapshot()["refused_set_parameters"] == 1
