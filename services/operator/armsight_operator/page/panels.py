"""The panels beside the scene: stop and state, what the arm should do, pictures, plots, health."""

import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt
import viser
import viser.uplot

from armsight_operator.modes import MODES
from armsight_operator.page.plots import STAGES, History, known
from armsight_operator.page.scene import JointFrame
from armsight_operator.page.state import Headline, Row

_COLORS = {"good": "#2b8a3e", "quiet": "#495057", "warning": "#b35900", "stopped": "#c92a2a"}
_DOTS = {"ok": "#2f9e44", "waiting": "#e8890c", "degraded": "#e8890c", "missing": "#e03131"}
_LINES = ("#1971c2", "#e8590c", "#2f9e44", "#9c36b5", "#0b7285", "#5c3c00", "#d6336c")

_PLOT_FONT = "11px sans-serif"
_PLOT_PX = 120
_TIMES: viser.uplot.Axis = {"size": 24, "font": _PLOT_FONT}
_LAST = 1e9
"""Where pictures appear later and the plot is to stay below them."""

# viser's buttons are two lines high wherever they are: the one that matters most is not.
_STYLE = """<style>
div:has(> div > .armsight-state) { display: grid; grid-template-columns: 3fr 2fr; }
div:has(> .armsight-state) { grid-column: 1 / -1; }
div:has(> .armsight-state) ~ div button { height: 3.6em !important; font-size: 1.15em; }
.armsight-state { padding: 0.2em 0.8em 0.6em 0.8em; min-height: 4.4em; line-height: 1.35; }
.armsight-state b { font-size: 1.5em; letter-spacing: 0.01em; }
.armsight-rows { padding: 0 0.8em 0.4em 0.8em; font-size: 0.85em; line-height: 1.4; }
.armsight-plot { padding: 0.3em 0.9em 0.2em 0.9em; font-size: 0.8em; line-height: 1.4; }
.armsight-plot span { white-space: nowrap; margin-right: 0.4em; font-weight: 600; }
.armsight-rows td { padding: 0.12em 0.6em 0.12em 0; vertical-align: top; }
</style>"""


class StopPanel:
    """Always in view: how the arm is and why, STOP, and release beside it.

    Args:
        gui: of all viewers.
        stop: asked to stop.
        release: asked to let go again.
    """

    def __init__(self, gui: viser.GuiApi, stop: Callable[[], None], release: Callable[[], None]) -> None:
        """Adds the panel."""
        panel = gui.add_panel()
        with panel.add_tab("Arm"):
            self._state = gui.add_html("")
            self._stop = gui.add_button("STOP", color="red", icon=viser.Icon.HAND_STOP)
            self._release = gui.add_button("Release", color="green", icon=viser.Icon.PLAYER_PLAY, disabled=True)
        panel.float(x=16, y=-16, width=350)
        command = gui.add_command("Stop the arm", hotkey="S", modifier="shift", icon=viser.Icon.HAND_STOP)
        self._stop.on_click(lambda _: stop())
        command.on_trigger(lambda _: stop())
        self._release.on_click(lambda _: release())

    def update(self, headline: Headline, trouble: str, *, may_release: bool) -> None:
        """Says how things are.

        Args:
            headline: the arm's state.
            trouble: what went wrong with a wish; empty: nothing.
            may_release: whether this page stopped the arm.
        """
        said = f'<div style="color:#c92a2a">{_marked(trouble)}</div>' if trouble else ""
        self._state.content = (
            f'{_STYLE}<div class="armsight-state" data-level="{headline.level}">'
            f'<b style="color:{_COLORS[headline.level]}">{escape(headline.title)}</b>'
            f"<div>{_marked(headline.why)}</div>{said}</div>"
        )
        self._release.disabled = not may_release


class MovePanel:
    """Mode, and a slider for each joint.

    Args:
        gui: of all viewers.
        mode: takes the name of a mode that a viewer chose.
        joints: takes angles by joint, rad, that a viewer set.
    """

    def __init__(
        self, gui: viser.GuiApi, mode: Callable[[str], None], joints: Callable[[Mapping[str, float]], None]
    ) -> None:
        """Adds what does not depend on the arm."""
        self._gui = gui
        self._joints = joints
        self._sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        self._folder = gui.add_folder("What the arm does")
        with self._folder:
            self._mode = gui.add_dropdown("mode", MODES, hint=_MODES_HINT)
        self._mode.on_update(lambda event: self._chosen(event, mode))

    def arrange(self, frames: Sequence[JointFrame]) -> None:
        """A slider for each joint of the arm."""
        for slider in self._sliders.values():
            slider.remove()
        with self._folder:
            self._sliders = {
                frame.name: self._gui.add_slider(
                    f"{frame.name} (rad)",
                    min=round(frame.lower_rad, 3),
                    max=round(frame.upper_rad, 3),
                    step=0.001,
                    initial_value=min(frame.upper_rad, max(frame.lower_rad, 0.0)),
                )
                for frame in frames
            }
        for slider in self._sliders.values():
            slider.on_update(self._moved)

    def show_mode(self, mode: str) -> None:
        """The mode in force."""
        if mode in MODES and self._mode.value != mode:
            _show(self._mode, mode)

    def show_angles(self, angles: Mapping[str, float]) -> None:
        """Moves the sliders along with the arm."""
        for name, slider in self._sliders.items():
            if name in angles:
                _show(slider, round(min(slider.max, max(slider.min, angles[name])), 3))

    def _chosen(self, event: viser.GuiEvent[viser.GuiDropdownHandle[str]], mode: Callable[[str], None]) -> None:
        if event.client_id is None:  # not a viewer: we ourselves show the mode in force
            return
        if self._mode.value == "joints":
            self._joints(self._values())
        else:
            mode(self._mode.value)

    def _moved(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        if event.client_id is not None:
            self._joints(self._values())

    def _values(self) -> dict[str, float]:
        return {name: slider.value for name, slider in self._sliders.items()}


_MODES_HINT = (
    "hold: stay; joints: as the sliders say; track: the tip goes to the target; follow: near the orange sphere; "
    "test-1, test-2, test-all: given motions"
)


class HealthPanel:
    """Every process: how it is, and what to do."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Adds the folder."""
        with gui.add_folder("Health"):
            self._table = gui.add_html("")

    def update(self, rows: Sequence[Row], latency: str) -> None:
        """Shows all rows, and the loop's speed below them."""
        lines = "".join(
            f'<tr data-service="{escape(row.name)}" data-status="{escape(row.status)}">'
            f'<td style="color:{_DOTS.get(row.status, _DOTS["degraded"])}">●</td><td>{escape(row.name)}</td>'
            f"<td>{escape(row.status)}</td><td>{_marked(row.text)}</td></tr>"
            for row in rows
        )
        self._table.content = f'<div class="armsight-rows"><table>{lines}</table>{_marked(latency)}</div>'


class CameraPanel:
    """The cameras' live pictures."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Adds the panel; pictures appear as they come."""
        self._gui = gui
        self._panel = gui.add_panel()
        self._tab = self._panel.add_tab("Cameras", icon=viser.Icon.CAMERA)
        self._pictures: dict[str, viser.GuiImageHandle] = {}
        self._panel.dock_left()
        self._panel.set_width(320)

    @property
    def tab(self) -> viser.GuiTabHandle:
        """For what belongs below the pictures."""
        return self._tab

    def show(self, camera: str, pixels: npt.NDArray[np.uint8]) -> None:
        """A camera's newest picture."""
        if camera in self._pictures:
            self._pictures[camera].image = pixels
            return
        with self._tab:
            self._pictures[camera] = self._gui.add_image(pixels, label=None, format="jpeg", jpeg_quality=80)


class Plots:
    """Angles and latency of the last half minute in the main panel, the estimate's error below the pictures.

    Args:
        gui: of all viewers.
        below_pictures: the tab of the pictures.
    """

    def __init__(self, gui: viser.GuiApi, below_pictures: viser.GuiTabHandle) -> None:
        """Adds nothing yet: plots need the joints' names."""
        self._gui = gui
        self._below_pictures = below_pictures
        self._names: tuple[str, ...] = ()
        self._parts: list[viser.GuiUplotHandle | viser.GuiHtmlHandle] = []
        self._plots: list[viser.GuiUplotHandle] = []

    def arrange(self, names: tuple[str, ...]) -> None:
        """Plots for the arm's joints."""
        for part in self._parts:
            part.remove()
        self._parts, self._plots, self._names = [], [], names
        joints = list(zip(names, _LINES, strict=False))
        angles: list[viser.uplot.Series] = []
        for _, color in joints:
            angles += [{"stroke": color, "width": 1.5}, {"stroke": color, "width": 1, "dash": (4, 4)}]
        stages = list(zip(STAGES, _LINES, strict=False))
        self._add("joint angles, rad; dashed: true", joints, angles)
        self._add("time in each stage, ms", stages, [{"stroke": color, "width": 1.5} for _, color in stages])
        with self._below_pictures:
            self._add("estimated tip, mm from the true one", [], [{"stroke": _LINES[-1], "width": 1.5}], order=_LAST)

    def update(self, history: History) -> None:
        """Shows the newest samples."""
        if not self._plots:
            return
        columns = (history.angles(self._names), history.stages(), [history.tip_error_mm()])
        for plot, data in zip(self._plots, columns, strict=True):
            complete = known(history.times(), data)
            if len(complete[0]) > 1:
                plot.data = complete

    def _add(
        self,
        title: str,
        key: Sequence[tuple[str, str]],
        series: Sequence[viser.uplot.Series],
        order: float | None = None,
    ) -> None:
        names = " ".join(f'<span style="color:{color}">{escape(name)}</span>' for name, color in key)
        head = f'<div class="armsight-plot"><b>{escape(title)}</b> {names}</div>'
        plot = self._gui.add_uplot(
            data=(np.array([-1.0, 0.0]), *(np.zeros(2) for _ in series)),
            series=({}, *series),
            scales={"x": {"time": False, "auto": True}},
            axes=(_TIMES, {"size": 44, "font": _PLOT_FONT, "space": 20}),
            legend={"show": False},
            height=_PLOT_PX,
            order=order,
        )
        before = None if order is None else order - 0.5
        self._parts += [self._gui.add_html(head, order=before if before is not None else plot.order - 0.5), plot]
        self._plots.append(plot)


def _show(control: Any, value: object) -> None:
    """Sets what a control shows; viser's types take the value for read-only."""
    control.value = value


def _marked(text: str) -> str:
    """Plain text as HTML; `commands` in their own letters."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(text))
