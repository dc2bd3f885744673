"""Parts of one's own, as `examples/` has them: each short, and each at work in a running stack."""

import ast
import subprocess
import sys
import tokenize
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from armsight import topics
from armsight_control import Arm, Problem, arm_of, forward, jacobian, solve
from armsight_control.chain import Array
from armsight_sim.description import describe_arm
from armsight_sim.world import load_model
from rig import Rig

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
MOST_LINES = 40

pytestmark = pytest.mark.untimed  # in lockstep


def lines_of_code(file: Path) -> int:
    """Without imports, docstrings, comments, and what starts the process."""
    source = file.read_text(encoding="utf-8")
    tree = ast.parse(source)
    aside: set[int] = set()
    for node in ast.walk(tree):
        start = isinstance(node, ast.If) and ast.unparse(node.test) == "__name__ == '__main__'"
        text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        if isinstance(node, ast.stmt) and (start or text or isinstance(node, ast.Import | ast.ImportFrom)):
            aside |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    with file.open("rb") as opened:
        empty = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING}
        lines = {
            line
            for token in tokenize.tokenize(opened.readline)
            if token.type not in empty | {tokenize.ENDMARKER}
            for line in range(token.start[0], token.end[0] + 1)
        }
    return len(lines - aside)


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_an_example_has_at_most_forty_lines(file: Path) -> None:
    assert 5 < lines_of_code(file) <= MOST_LINES


@contextmanager
def beside(rig: Rig, script: str, *arguments: str) -> Iterator[None]:
    """A part of one's own as a process on the stack's router."""
    where = ["--connect", rig.stack.endpoint, "--namespace", rig.stack.namespace]
    process = subprocess.Popen([sys.executable, str(EXAMPLES / script), *arguments, *where])
    try:
        yield
    finally:
        process.terminate()
        try:
            assert process.wait(timeout=2) == 0
        finally:
            process.kill()


def settled(rig: Rig, arm: Arm, target: tuple[float, float, float], within_m: float) -> None:
    def off_m() -> float:
        return float(np.linalg.norm(forward(arm.chain, rig.true_joints()) - target))

    with rig.publishing_target(target):
        rig.wait_until(lambda: off_m() < within_m, 40, f"the tip is within {within_m} m of {target}")


@pytest.fixture(scope="module")
def arm() -> Arm:
    return arm_of(describe_arm(load_model()))


def pose(arm: Arm, rng: np.random.Generator) -> Array:
    return rng.uniform(arm.chain.limits[:, 0], arm.chain.limits[:, 1])


def test_the_loop_closes_over_a_vision_of_ones_own(make_rig: Callable[..., Rig], arm: Arm) -> None:
    rig = make_rig(target="none", mode="track", clock="lockstep")
    for service in ("router", "sim", "control"):
        rig.start(service)
    with beside(rig, "hue_vision.py"):
        # its middles are off where a link hides a part of a marker
        settled(rig, arm, (3.0, 2.5, 7.5), within_m=0.15)
        settled(rig, arm, (-2.0, 3.5, 7.0), within_m=0.15)


def test_the_loop_closes_over_an_estimator_and_a_solver_of_ones_own(make_rig: Callable[..., Rig], arm: Arm) -> None:
    flags = ["--estimator", str(EXAMPLES / "gauss_newton_estimator.py:FromSetpoint")]
    flags += ["--solver", str(EXAMPLES / "least_squares_solver.py:solve")]
    rig = make_rig(target="none", mode="track", clock="lockstep", extra={"control": flags})
    rig.start_all()
    settled(rig, arm, (3.0, 2.5, 7.5), within_m=0.02)
    settled(rig, arm, (-2.0, 3.5, 7.0), within_m=0.02)
    status = rig.bus.subscriber(topics.CONTROL_STATUS).recv(5)
    assert status is not None
    assert status.message.estimator.endswith("gauss_newton_estimator.py:FromSetpoint")
    assert rig.counters("control").get("held_estimator", 0) == 0


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy")
    armsight = Path(sys.executable).with_name("armsight")
    model = ROOT / "services/sim/armsight_sim/models/arm.xml"
    described = subprocess.run([armsight, "describe", model, "--json"], capture_output=True, check=True)
    (folder / "arm.json").write_bytes(described.stdout)
    command = [sys.executable, *map(str, (EXAMPLES / "train_policy.py", folder / "arm.json", folder / "policy.pt"))]
    subprocess.run(command, check=True)
    return folder / "policy.pt"


def test_the_loop_closes_over_a_learned_policy(make_rig: Callable[..., Rig], arm: Arm, weights: Path) -> None:
    rig = make_rig(target="none", clock="lockstep")
    for service in ("router", "sim", "vision"):
        rig.start(service)
    truth = rig.bus.subscriber(topics.JOINTS_TRUE)
    assert truth.recv(30) is not None, "sim draws"
    rig.reset((0.3, 0.2, -0.5, 0.5))
    with beside(rig, "policy_controller.py", str(weights)):
        settled(rig, arm, (3.0, 2.5, 7.5), within_m=0.02)
        settled(rig, arm, (1.0, 4.0, 7.0), within_m=0.02)
        refused = {name for name in rig.counters("sim") if name.startswith("command_refused")}
        assert refused <= {"command_refused_before_reset"}  # an answer to what was seen before it


def test_what_the_policy_learnt_brings_the_tip_nearer_in_poses_it_never_saw(arm: Arm, weights: Path) -> None:
    sys.path.insert(0, str(EXAMPLES))
    try:
        import torch
        from train_policy import Policy
    finally:
        sys.path.pop(0)
    policy, rng, shares = Policy.read(str(weights)), np.random.default_rng(40823), []
    for _ in range(200):
        q, missing = pose(arm, rng), rng.normal(size=3)
        with torch.no_grad():
            motion = policy(torch.tensor(q).float(), torch.tensor(missing).float()).double().numpy()
        shares.append(float(np.linalg.norm(jacobian(arm.chain, q) @ motion - missing) / np.linalg.norm(missing)))
    assert np.median(shares) < 0.3


def test_the_solver_of_ones_own_reaches_what_can_be_reached(arm: Arm) -> None:
    rng, place = np.random.default_rng(71), str(EXAMPLES / "least_squares_solver.py:solve")
    residuals = []
    for _ in range(40):
        goal, start = pose(arm, rng), pose(arm, rng)
        solution = solve(place, Problem(arm.chain, forward(arm.chain, goal), start, (0, 1, 2, 3)))
        residuals.append(solution.residual_m)
    assert max(residuals) < 1e-3
