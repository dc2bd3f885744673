"""Which of the simulation's settings may be changed while it runs."""

from collections.abc import Mapping
from dataclasses import replace

from armsight.parameters import Tunable, Value
from armsight_sim.settings import MOST_NOISE, Settings
from armsight_sim.targets import NONE, TARGETS, VISIBLE


def tunables(settings: Settings) -> tuple[Tunable, ...]:
    """The settings that may be changed, from those that the simulation starts with."""
    # bodies are part of the arm's description: they are there from the start or not at all
    targets = tuple(name for name in (NONE, *TARGETS) if name != VISIBLE or settings.target == VISIBLE)
    target = Tunable("target", "moving target to publish until somebody else does", settings.target, choices=targets)
    if settings.external_cameras:
        return (target,)  # nothing is drawn
    return (
        Tunable("samples", "for each pixel: 0, or 4 for smoother and slower pictures", settings.samples, "", 0, 4),
        Tunable("ambient", "brightness of the ambient light", settings.ambient or 0.0, "", 0.0, 1.0),
        Tunable("ambient_sweep", "let the ambient light sweep slowly from 0.1 to 0.7", settings.ambient is None),
        Tunable("noise", "standard deviation of the pictures' noise", settings.noise, "grey levels", 0.0, MOST_NOISE),
        target,
    )


def tuned(settings: Settings, values: Mapping[str, Value]) -> Settings:
    """The settings with new values.

    Raises:
        ConfigError: samples that can't be drawn.
    """
    target = str(values["target"])
    if settings.external_cameras:
        return replace(settings, target=target)
    samples, ambient, noise = (values[name] for name in ("samples", "ambient", "noise"))
    assert isinstance(samples, int)
    assert isinstance(ambient, float)
    assert isinstance(noise, float)
    sweep = bool(values["ambient_sweep"])
    return replace(settings, samples=samples, ambient=None if sweep else ambient, noise=noise, target=target)
