"""Rendering the cameras off screen, by the OpenGL back end that :mod:`armsight_sim.gl` chose."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from armsight_sim.conventions import size_of

Image = npt.NDArray[np.uint8]

# Offsets into one long strip of noise: a prime, so that rows never line up.
_NOISE_SLACK = 65_521


def facet_shrinkage(slices: int, stacks: int) -> float:
    """Radius of a drawn sphere's outline as a share of the true one, mean over all directions of view.

    OpenGL draws spheres as polyhedra with their corners on the sphere. Measured on renders at random orientations to
    0.0002; a camera that knows how large a marker is would take the missing 0.4 % for 80 mm of distance.
    """
    return 1.0 - 0.2 * ((np.pi / slices) ** 2 + (np.pi / (2 * stacks)) ** 2)


@dataclass(frozen=True, slots=True)
class Commission:
    """What is to be drawn, and how."""

    model: mujoco.MjModel
    """Left as it is."""
    names: Sequence[str]
    """Of the cameras; none needs no OpenGL."""
    width: int
    """Columns of the images of cameras whose `resolution` says nothing."""
    height: int
    """Rows of these."""
    samples: int
    """Per pixel, 0 or 4 (software GL gives no more)."""
    emissive: bool = False
    """Whether spheres with a material shine evenly, whatever the light."""
    groups: Sequence[int] = ()
    """Of geoms that are drawn beside those that MuJoCo shows by itself."""

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Of the cameras' images in the order of the names: columns and rows."""
        return [picture_size(self.model, name, self.width, self.height) for name in self.names]


class Cameras:
    """All cameras of a model, drawn one after the other, in one OpenGL context for each size of picture.

    Use from one thread; close it.
    """

    def __init__(self, wanted: Commission) -> None:
        """Allocates the contexts."""
        drawn = copy.copy(wanted.model)
        drawn.vis.quality.offsamples = wanted.samples
        spheres = drawn.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
        shrinkage = facet_shrinkage(drawn.vis.quality.numslices, drawn.vis.quality.numstacks)
        drawn.geom_size[spheres] /= shrinkage
        drawn.site_size[drawn.site_type == mujoco.mjtGeom.mjGEOM_SPHERE] /= shrinkage
        if wanted.emissive:
            materials = np.unique(drawn.geom_matid[spheres])
            drawn.mat_emission[materials[materials >= 0]] = 1.0
        self._names, self._sizes = tuple(wanted.names), wanted.sizes
        buffer = drawn.vis.global_
        buffer.offwidth = max((buffer.offwidth, *(columns for columns, _ in self._sizes)))
        buffer.offheight = max((buffer.offheight, *(rows for _, rows in self._sizes)))
        self._drawn = drawn
        self._renderers = {size: mujoco.Renderer(drawn, size[1], size[0]) for size in dict.fromkeys(self._sizes)}
        self._options = mujoco.MjvOption()
        self._options.geomgroup[list(wanted.groups)] = 1
        flags = mujoco.mjtRndFlag
        # shadows alone cost six times the rest; the backdrops stand in place of sky and haze
        for flag in (flags.mjRND_SHADOW, flags.mjRND_REFLECTION, flags.mjRND_HAZE, flags.mjRND_FOG, flags.mjRND_SKYBOX):
            for renderer in self._renderers.values():
                renderer.scene.flags[flag] = 0

    def light(self, ambient: float) -> None:
        """Sets the brightness of the ambient light, 0 to 1."""
        self._drawn.vis.headlight.ambient[:] = ambient

    def draw(
        self,
        data: mujoco.MjData,
        into: Sequence[Image] | None = None,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> list[Image]:
        """One rgb8 image for each camera, the top row first.

        Args:
            data: of the model; with what follows from the joints' angles.
            into: images to draw into, (rows, columns, 3) each (default: new ones).
            meanwhile: what is to be done beside; once.
        """
        meanwhile()
        places = [None] * len(self._names) if into is None else into
        return [self._draw(data, *each) for each in zip(self._names, self._sizes, places, strict=True)]

    def close(self) -> None:
        """Frees the contexts; OSMesa's fail at exit when they are left to the interpreter."""
        for renderer in self._renderers.values():
            renderer.close()

    def _draw(self, data: mujoco.MjData, name: str, size: tuple[int, int], into: Image | None) -> Image:
        renderer = self._renderers[size]
        renderer.update_scene(data, name, self._options)
        image: Image = renderer.render(out=into)
        return image


def picture_size(model: mujoco.MjModel, camera: str, width: int, height: int) -> tuple[int, int]:
    """Columns and rows of a camera's images: what its `resolution` in the model says, else these."""
    return size_of(model, model.camera(camera).id) or (width, height)


class Noise:
    """Sensor noise of a fixed standard deviation, the same in every run with the same seed."""

    def __init__(self, sigma: float, size: int, seed: int) -> None:
        """Draws one strip of noise, from which every frame takes a piece.

        Args:
            sigma: standard deviation in grey levels.
            size: bytes of a frame.
            seed: of the strip and of where each frame begins.
        """
        random = np.random.default_rng(seed)
        self._strip = np.rint(random.normal(0.0, sigma, size + _NOISE_SLACK)).astype(np.int16)
        self._offsets = np.random.default_rng([seed, 1])

    def add(self, image: Image) -> Image:
        """The image with noise, clipped to 0..255."""
        start = int(self._offsets.integers(_NOISE_SLACK))
        noisy = image.reshape(-1).astype(np.int16) + self._strip[start : start + image.size]
        return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8).reshape(image.shape)
