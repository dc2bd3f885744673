"""Other libraries' inverse kinematics on the report's arm, each as its documentation says.

pin and mink are development dependencies and run in the benchmark's own process. The others are run by request,
each in a process of an environment of its own (`python ik_peers.py NAME JOINTS`): a line of JSON with target and
start in, one with the solution and the seconds it took out. This file then has to do with numpy and that library alone.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
import venv
from abc import ABC, abstractmethod
from pathlib import Path
from time import perf_counter
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE_M = 1e-7
"""Asked of every peer that can be asked."""
_LINKS = {"joint1": ("0 0 1", 0.0), "joint2": ("0 1 0", 4.0), "joint3": ("1 0 0", 0.0), "joint4": ("0 1 0", 3.2)}
_TIP = 2.8
_LIMITS = {"joint1": math.pi} | dict.fromkeys(("joint2", "joint3", "joint4"), math.pi / 2)


class Peer(ABC):
    """One library, set up for three or four joints."""

    packages: tuple[str, ...]
    """What to install for it."""

    def __init__(self, joints: int) -> None:
        """Loads the library and its model of the arm."""
        self.names = [name for name in _LINKS if joints == 4 or name != "joint2"]
        self.upper = np.array([_LIMITS[name] for name in self.names])
        self.rng = np.random.default_rng(7)
        self.posture: Array | None = None
        """A configuration with an orientation that can be had at the target, for who needs one; none: nobody knows."""
        self.set_up()

    @abstractmethod
    def set_up(self) -> None:
        """Builds the library's model."""

    @abstractmethod
    def solve(self, target: Array, start: Array) -> Array:
        """A configuration of the joints that may move."""

    def urdf(self) -> str:
        """The arm; a joint that may not move is fixed."""
        inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        parts, parent = [f'<robot name="arm"><link name="base">{inertial}</link>'], "base"
        for name, (axis, z) in [*_LINKS.items(), ("tip", ("0 0 1", _TIP))]:
            child, upper = ("ee" if name == "tip" else f"link_{name}"), _LIMITS.get(name, 0.0)
            kind = "revolute" if name in self.names else "fixed"
            limit = f'<limit lower="{-upper}" upper="{upper}" effort="100" velocity="100"/>'
            parts.append(
                f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
                f'<origin xyz="0 0 {z}" rpy="0 0 0"/><axis xyz="{axis}"/>{limit if kind == "revolute" else ""}</joint>'
                f'<link name="{child}">{inertial}</link>'
            )
            parent = child
        return "".join(parts) + "</robot>"

    def urdf_file(self) -> str:
        """The same in a file that lives as long as this object."""
        self._file = tempfile.NamedTemporaryFile("w", suffix=".urdf")  # noqa: SIM115  (deleted with this object)
        self._file.write(self.urdf())
        self._file.flush()
        return self._file.name


class Pin(Peer):
    """Pinocchio's kinematics and Jacobian in a damped loop with clipping and restarts: it has no solver of its own."""

    packages = ("pin",)

    def set_up(self) -> None:
        """Builds the model from the URDF."""
        import pinocchio

        self.pin = pinocchio
        self.model = pinocchio.buildModelFromXML(self.urdf())
        self.data = self.model.createData()
        self.frame = self.model.getFrameId("ee")

    def solve(self, target: Array, start: Array) -> Array:
        """Full steps, damped by the error, clipped to the limits."""
        q, best, least = start, start, math.inf
        for _ in range(20):
            for _ in range(40):
                slope = self.pin.computeFrameJacobian(
                    self.model, self.data, q, self.frame, self.pin.LOCAL_WORLD_ALIGNED
                )[:3]
                self.pin.updateFramePlacement(self.model, self.data, self.frame)
                error = target - self.data.oMf[self.frame].translation
                squared = float(error @ error)
                if squared < least:
                    best, least = q, squared
                if squared < TOLERANCE_M**2:
                    return q
                step = slope.T @ np.linalg.solve(slope @ slope.T + (1e-2 * squared + 1e-12) * np.eye(3), error)
                q = np.clip(q + step, -self.upper, self.upper)
            q = self.rng.uniform(-self.upper, self.upper)
        return best


class Mink(Peer):
    """mink's differential inverse kinematics, iterated as its documentation does."""

    packages = ("mink", "daqp")

    def set_up(self) -> None:
        """Builds the MuJoCo model."""
        import mink
        import mujoco

        body = f'<site name="ee" pos="0 0 {_TIP}"/>'
        for name, (axis, z) in reversed(_LINKS.items()):
            upper = _LIMITS[name]
            joint = f'<joint name="{name}" axis="{axis}" range="{-upper} {upper}"/>' if name in self.names else ""
            inertial = '<inertial pos="0 0 0.1" mass="1" diaginertia="1 1 1"/>'
            body = f'<body pos="0 0 {z}">{inertial}{joint}{body}</body>'
        self.mink = mink
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{body}</worldbody></mujoco>'
        )
        self.configuration = mink.Configuration(self.model)
        self.task = mink.FrameTask("ee", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1.0)
        self.limits = [mink.ConfigurationLimit(self.model)]

    def solve(self, target: Array, start: Array) -> Array:
        """At most a hundred steps."""
        self.configuration.update(start.copy())
        for _ in range(100):
            place = self.configuration.get_transform_frame_to_world("ee", "site")
            if np.linalg.norm(place.translation() - target) < TOLERANCE_M:
                break
            self.task.set_target(self.mink.SE3.from_rotation_and_translation(place.rotation(), target))
            try:
                speed = self.mink.solve_ik(
                    self.configuration, [self.task], 1.0, "daqp", damping=1e-9, limits=self.limits
                )
            except self.mink.NoSolutionFound:
                break
            self.configuration.integrate_inplace(speed, 1.0)
        return np.array(self.configuration.q)


class Scipy(Peer):
    """least_squares within bounds, the Jacobian exact, from one start."""

    packages = ("scipy",)

    def set_up(self) -> None:
        """Loads scipy, and pinocchio for kinematics."""
        from scipy.optimize import least_squares

        self.least_squares = least_squares
        self.kinematics = Pin(len(self.names))

    def solve(self, target: Array, start: Array) -> Array:
        """Trust-region reflective, the default for bounds."""
        pin, model, data, frame = (getattr(self.kinematics, name) for name in ("pin", "model", "data", "frame"))

        def error(q: Array) -> Array:
            pin.framesForwardKinematics(model, data, q)
            return np.asarray(data.oMf[frame].translation - target)

        def slope(q: Array) -> Array:
            return np.asarray(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3])

        bounds = (-self.upper, self.upper)
        inside = np.clip(start, -self.upper + 1e-6, self.upper - 1e-6)
        return np.asarray(self.least_squares(error, inside, slope, bounds, xtol=1e-12, ftol=1e-15, gtol=1e-12).x)


class RoboticsToolbox(Peer):
    """Its Levenberg-Marquardt in C++, with joint limits and its own restarts."""

    packages = ("roboticstoolbox-python",)

    def set_up(self) -> None:
        """Builds the chain of elementary transforms."""
        from roboticstoolbox import ET

        limits = {name: [-_LIMITS[name], _LIMITS[name]] for name in self.names}
        chain = ET.Rz(qlim=limits["joint1"]) * ET.tz(4.0)
        if "joint2" in limits:
            chain = chain * ET.Ry(qlim=limits["joint2"])
        chain = chain * ET.Rx(qlim=limits["joint3"]) * ET.tz(3.2) * ET.Ry(qlim=limits["joint4"]) * ET.tz(_TIP)
        self.chain, self.mask = chain, np.array([1.0, 1, 1, 0, 0, 0])

    def solve(self, target: Array, start: Array) -> Array:
        """By `ik_LM`; its tolerance is half of a squared distance."""
        pose = np.eye(4)
        pose[:3, 3] = target
        found = self.chain.ik_LM(pose, q0=start, mask=self.mask, tol=0.5 * TOLERANCE_M**2, joint_limits=True)
        return np.asarray(found[0] if isinstance(found, tuple) else found.q)


class Placo(Peer):
    """placo's quadratic program with joint limits, iterated."""

    packages = ("placo",)

    def set_up(self) -> None:
        """Builds the robot from the URDF."""
        import placo

        self.robot = placo.RobotWrapper(self.urdf_file(), placo.Flags.ignore_collisions)
        self.solver = placo.KinematicsSolver(self.robot)
        self.solver.mask_fbase(True)
        self.solver.enable_joint_limits(True)
        self.task = self.solver.add_position_task("ee", np.zeros(3))
        self.task.configure("ee", "soft", 1.0)
        self.solver.add_regularization_task(1e-4)

    def solve(self, target: Array, start: Array) -> Array:
        """At most a hundred steps."""
        for name, angle in zip(self.names, start, strict=True):
            self.robot.set_joint(name, float(angle))
        self.robot.update_kinematics()
        self.task.target_world = target
        for _ in range(100):
            if np.linalg.norm(self.robot.get_T_world_frame("ee")[:3, 3] - target) < TOLERANCE_M:
                break
            try:
                self.solver.solve(True)
            except RuntimeError:
                break
            self.robot.update_kinematics()
        return np.array([self.robot.get_joint(name) for name in self.names])


class PytorchKinematics(Peer):
    """Its pseudo-inverse solver with ten starts, the given one first."""

    packages = ("pytorch-kinematics",)

    def set_up(self) -> None:
        """Builds the chain from the URDF."""
        import pytorch_kinematics
        import torch

        torch.set_num_threads(1)
        self.torch, self.kinematics = torch, pytorch_kinematics
        chain = pytorch_kinematics.build_serial_chain_from_urdf(self.urdf().encode(), "ee").to(dtype=torch.float64)
        self.solver = pytorch_kinematics.PseudoInverseIK(
            chain,
            retry_configs=torch.zeros(10, len(self.names), dtype=torch.float64),
            joint_limits=torch.tensor(np.stack([-self.upper, self.upper], axis=1)),
            pos_tolerance=TOLERANCE_M,
            rot_tolerance=1e9,
            orientation_weight=0.0,
            max_iterations=50,
            early_stopping_any_converged=True,
            early_stopping_no_improvement=None,
        )

    def solve(self, target: Array, start: Array) -> Array:
        """The start that came nearest."""
        starts = self.rng.uniform(-self.upper, self.upper, (10, len(self.names)))
        starts[0] = start
        self.solver.initial_config = self.torch.tensor(starts)
        pose = self.torch.eye(4, dtype=self.torch.float64)[None]
        pose[:, :3, 3] = self.torch.tensor(target)
        found = self.solver.solve(self.kinematics.Transform3d(matrix=pose))
        return np.asarray(found.solutions[0, found.err_pos[0].argmin()])


class Ikpy(Peer):
    """ikpy's optimisation, as it comes but for the tolerance."""

    packages = ("ikpy",)

    def set_up(self) -> None:
        """Builds the chain from the URDF."""
        from ikpy.chain import Chain

        file = self.urdf_file()
        active = [link.name in self.names for link in Chain.from_urdf_file(file, base_elements=["base"]).links]
        self.chain = Chain.from_urdf_file(file, base_elements=["base"], active_links_mask=active)
        self.places = np.flatnonzero(active)

    def solve(self, target: Array, start: Array) -> Array:
        """From one start."""
        full = np.zeros(len(self.chain.links))
        full[self.places] = start
        found = self.chain.inverse_kinematics(target_position=target, initial_position=full, tol=1e-12)
        return np.asarray(found[self.places])


class TracIk(Peer):
    """TRAC-IK solves for whole poses only: it is told the orientation that the target was made with, or the start's."""

    packages = ("pytracik",)

    def set_up(self) -> None:
        """Builds the solver from the URDF."""
        from trac_ik import TracIK

        self.solver = TracIK("base", "ee", self.urdf_file(), timeout=0.02, epsilon=TOLERANCE_M)

    def solve(self, target: Array, start: Array) -> Array:
        """With an orientation where there is one, else with that of the start."""
        found = self.solver.ik(target, self.solver.fk(start if self.posture is None else self.posture)[1], start)
        return start if found is None else np.asarray(found)


PEERS: dict[str, type[Peer]] = {
    "pin": Pin,
    "mink": Mink,
    "scipy": Scipy,
    "roboticstoolbox-python": RoboticsToolbox,
    "placo": Placo,
    "pytorch-kinematics": PytorchKinematics,
    "ikpy": Ikpy,
    "pytracik": TracIk,
}
ALWAYS = ("pin", "mink", "scipy")


class Remote:
    """A peer in a process of an environment of its own, which is made when it is not there."""

    def __init__(self, name: str, joints: int, folder: Path) -> None:
        """Starts it; installing may take minutes."""
        home = folder / name
        python = home / "bin" / "python"
        if not (home / ".installed").exists():
            venv.create(home, clear=True, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", "numpy", *PEERS[name].packages], check=True)
            (home / ".installed").touch()
        self.process: subprocess.Popen[str] = subprocess.Popen(
            [python, __file__, name, str(joints)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.posture: Array | None = None
        self._read()

    def solve(self, target: Array, start: Array) -> tuple[Array, float]:
        """The solution, and the seconds that the peer took for it."""
        assert self.process.stdin is not None
        posture = None if self.posture is None else self.posture.tolist()
        self.process.stdin.write(json.dumps([target.tolist(), start.tolist(), posture]) + "\n")
        self.process.stdin.flush()
        q, seconds = self._read()
        return np.array(q), seconds

    def close(self) -> None:
        """Ends the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def _read(self) -> Any:
        stream: IO[str] | None = self.process.stdout
        line = "" if stream is None else stream.readline()
        if not line:
            raise RuntimeError(f"{self.process.args} ended: see its message above")
        return json.loads(line)


def serve(name: str, joints: int) -> None:
    """The process of one peer: answers until its input ends."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # some libraries print, from C++ too
    peer = PEERS[name](joints)
    print(json.dumps("ready"), file=out, flush=True)
    for line in sys.stdin:
        target, start, posture = (None if values is None else np.array(values) for values in json.loads(line))
        assert target is not None
        assert start is not None
        peer.posture = posture
        began = perf_counter()
        q = peer.solve(target, start)
        print(json.dumps([np.asarray(q).tolist(), perf_counter() - began]), file=out, flush=True)


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]))
