"""What can be chosen about each solver, checked when it is chosen."""

from dataclasses import dataclass

from armsight_control.errors import SolverError


def _check(name: str, value: float, above: float, most: float) -> None:
    if not above < value <= most:
        raise SolverError(f"{name} {value} is not above {above:g} and at most {most:g}")


def _check_count(name: str, value: int, least: int, most: int) -> None:
    if not least <= value <= most:
        raise SolverError(f"{name} {value} is not between {least} and {most}")


@dataclass(frozen=True, slots=True)
class GradientDescentOptions:
    """The report's descent, section 4.2."""

    alpha: float = 0.01
    """Step size: the report's."""
    tolerance_m: float = 0.005
    """Of the mean absolute error over x, y and z: the report's."""
    max_steps: int = 500
    """The report's."""

    def __post_init__(self) -> None:
        """Refuses what can't work."""
        _check("alpha", self.alpha, 0, 1)
        _check("tolerance_m", self.tolerance_m, 0, 1)
        _check_count("max_steps", self.max_steps, 1, 100_000)


@dataclass(frozen=True, slots=True)
class TorchOptions:
    """The batched descent."""

    starts: int = 64
    """Per target, the problem's own among them: what a call of the compiled block computes in its shortest time."""
    momentum: float = 0.8
    """Of the speed, kept from step to step; heavier overshoots, lighter takes more steps."""
    step: float = 3.0
    """In units of 1 / (joints x lever²) per joint, the largest that surely descends: most poses bear more."""
    descent_m: float = 0.05
    """Where the descent ends and the last steps take over, which converge at once from there."""
    accept_m: float = 0.004
    """What counts as at the target: below the 5 mm that a solution is judged by."""
    tolerance_m: float = 1e-6
    """Where the last steps end if they get there: a thousandth of what vision can tell."""
    follow_m: float = 1.0
    """A start this near to its target is followed down its own branch before another's solution is taken."""
    max_steps: int = 1000
    """Of the descent: ten times what a target takes."""
    seed: int = 0
    """Of the starts, which are the same for every target."""
    compile_on_demand: bool = False
    """Compile what no package was made for, which takes up to a minute: for development."""

    def __post_init__(self) -> None:
        """Refuses what can't work."""
        _check_count("starts", self.starts, 1, 4096)
        _check("momentum", self.momentum, -1e-12, 0.999)
        _check("step", self.step, 0, 10)
        _check("descent_m", self.descent_m, 0, 1)
        _check("accept_m", self.accept_m, 0, 1)
        _check("tolerance_m", self.tolerance_m, 0, min(self.accept_m, self.descent_m))
        _check("follow_m", self.follow_m, 0, 1e3)
        _check_count("max_steps", self.max_steps, 1, 100_000)
        _check_count("seed", self.seed, 0, 2**31)


@dataclass(frozen=True, slots=True)
class LevenbergMarquardtOptions:
    """Levenberg-Marquardt with restarts."""

    tolerance_m: float = 1e-7
    """A tenth of the 1e-6 m that a solution is judged by; rounding in double precision is 1e-14 m."""
    damping: float = 1e-2
    """At the start, m²/rad²: a thousandth of a lever of this arm squared."""
    max_steps: int = 60
    """Of one start: five times what a start takes that arrives."""
    restarts: int = 32
    """Of a target that the problem's own start did not reach."""
    seed: int = 0
    """Of the restarts, which are the same for every target."""
    compile_on_demand: bool = False
    """As :attr:`TorchOptions.compile_on_demand`."""

    def __post_init__(self) -> None:
        """Refuses what can't work."""
        _check("tolerance_m", self.tolerance_m, 0, 1)
        _check("damping", self.damping, 0, 1e6)
        _check_count("max_steps", self.max_steps, 1, 100_000)
        _check_count("restarts", self.restarts, 0, 4096)
        _check_count("seed", self.seed, 0, 2**31)


@dataclass(frozen=True, slots=True)
class ClosedFormOptions:
    """The closed form with joint 2 free, where a family of solutions is left to choose from."""

    samples: int = 64
    """Of each half of the family, before the best one is refined."""
    tie_rad: float = 1e-6
    """Solutions whose motions differ by less are told apart by their distance from the limits."""

    def __post_init__(self) -> None:
        """Refuses what can't work."""
        _check_count("samples", self.samples, 8, 100_000)
        _check("tie_rad", self.tie_rad, 0, 1)


@dataclass(frozen=True, slots=True)
class Options:
    """Of all solvers; each takes its own."""

    gradient_descent: GradientDescentOptions = GradientDescentOptions()
    torch: TorchOptions = TorchOptions()
    levenberg_marquardt: LevenbergMarquardtOptions = LevenbergMarquardtOptions()
    closed_form: ClosedFormOptions = ClosedFormOptions()
