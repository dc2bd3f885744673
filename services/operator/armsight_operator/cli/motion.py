"""`armsight move`, `target`, `mode`, `reset`: what the arm should do."""

import time
from typing import TYPE_CHECKING, Annotated

import typer

from armsight_operator.cli.options import Connect, Namespace, ZenohConfig
from armsight_operator.errors import NoDataError, OperatorError
from armsight_operator.modes import MODES

if TYPE_CHECKING:
    from armsight.bus import Bus

_ANSWER_S = 5.0


def move(
    angles: Annotated[list[float], typer.Argument(help="One angle for each joint, in rad, from the base outwards.")],
    wait: Annotated[float, typer.Option(help="Seconds to wait until the arm is there; 0: don't.", min=0)] = 0.0,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Move the joints to given angles and hold them.

    Example: armsight move 0.5 0 0.8 -0.4
    """
    from armsight_operator.ask import ask_joints
    from armsight_operator.cli.bus import configuration, connected

    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        ask_joints(bus, _named(bus, angles))
        if wait > 0 and not _arrives(bus, angles, wait):
            raise OperatorError(f"the arm is not at {_text(angles)} within {wait:g} s: see `armsight status`")
    print(f"{'moved' if wait > 0 else 'moving'} to {_text(angles)} rad")


def target(
    x: Annotated[float, typer.Argument(help="Metres.")],
    y: Annotated[float, typer.Argument(help="Metres.")],
    z: Annotated[float, typer.Argument(help="Metres.")],
    frame: Annotated[str, typer.Option(help="base (joint 1's frame) or world.")] = "base",
    seconds: Annotated[float, typer.Option(help="Seconds to publish it; 0: until Ctrl-C.", min=0)] = 1.0,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Publish a point for the tip and follow it (mode track).

    Example: armsight target 3.0 1.0 7.0
    """
    from armsight import topics
    from armsight_operator.ask import TARGET_PERIOD_S, ask_mode, target_message
    from armsight_operator.cli.bus import configuration, connected

    target_message(x, y, z, frame)  # what can't be used is refused before anything is asked
    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        ask_mode(bus, "track")
        publisher = bus.publisher(topics.TARGET)
        print(f"target ({x:g}, {y:g}, {z:g}) m in the {frame} frame", flush=True)
        until = time.monotonic() + seconds
        while True:
            publisher.put(target_message(x, y, z, frame))
            if seconds > 0 and time.monotonic() >= until:
                break
            time.sleep(TARGET_PERIOD_S)


def mode(
    name: Annotated[str | None, typer.Argument(help=f"One of {', '.join(MODES)}; left out: show it.")] = None,
    start: Annotated[float, typer.Option(help="For the tests: where on their time axis to begin, s.", min=0)] = 0.0,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Show or set what control does.

    Example: armsight mode test-1
    """
    from armsight_operator.ask import ask_mode
    from armsight_operator.cli.bus import configuration, connected

    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        print(ask_mode(bus, name, start))


def reset(
    angles: Annotated[list[float] | None, typer.Argument(help="One angle for each joint, in rad; none: zero.")] = None,
    connect: Connect = None,
    namespace: Namespace = None,
    zenoh_config: ZenohConfig = None,
) -> None:
    """Put the simulated arm into a pose at rest.

    Example: armsight reset 0 0 0.5 0.5
    """
    from armsight import topics
    from armsight.v1.sim_pb2 import ResetRequest
    from armsight_operator.ask import setpoints
    from armsight_operator.cli.bus import configuration, connected

    with connected(configuration(connect, namespace, zenoh_config)) as bus:
        joints = setpoints(_named(bus, angles)) if angles else []
        bus.query(topics.RESET, ResetRequest(joints=joints), timeout_s=_ANSWER_S)
    print(f"reset to {_text(angles) if angles else 'zero'}")


def _named(bus: "Bus", angles: list[float]) -> dict[str, float]:
    from armsight import topics
    from armsight.errors import ConfigError

    received = bus.subscriber(topics.DESCRIPTION).recv(_ANSWER_S)
    if received is None:
        raise NoDataError("no description of the arm: is sim running?")
    names = [joint.name for joint in received.message.joints]
    if len(angles) != len(names):
        raise ConfigError(f"{len(angles)} angles given; this arm has {len(names)} joints: {', '.join(names)}")
    return dict(zip(names, angles, strict=True))


def _arrives(bus: "Bus", angles: list[float], timeout_s: float) -> bool:
    from armsight import topics

    estimated = bus.subscriber(topics.JOINTS_ESTIMATED)
    until = time.monotonic() + timeout_s
    while (left := until - time.monotonic()) > 0:
        received = estimated.recv(left)
        if received is None:
            break
        at = [joint.position for joint in received.message.joints]
        if len(at) == len(angles) and all(abs(a - b) < 0.01 for a, b in zip(at, angles, strict=True)):
            return True
    return False


def _text(angles: list[float]) -> str:
    return f"({', '.join(f'{angle:g}' for angle in angles)})"
