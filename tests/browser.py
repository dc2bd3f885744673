"""A page in a headless Chromium: opened, looked at, clicked and dragged as a person would."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
from playwright.sync_api import Browser, Locator, Page, sync_playwright

CHROMIUM = shutil.which("chromium")

# Software rendering, as there need be no GPU; Chromium's sandbox can't be had by root.
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]

LOAD_MS = 60_000
# Only what fails takes this long.
WAIT_MS = 60_000

# viser's own, of its initial camera, vertically
_FOV_RAD = np.radians(75.0)

Vector = npt.NDArray[np.float64]


@contextmanager
def chromium(folder: Path) -> Iterator[Browser]:
    """A browser that leaves the processor to the loop when both want it.

    Args:
        folder: for the script that starts it.
    """
    assert CHROMIUM is not None, "these tests need Debian's package chromium: tools/apt-packages-browser.txt"
    polite = folder / "chromium"
    as_root = os.geteuid() == 0
    # root's Chromium would give itself the processor before everybody else
    humble = "setpriv --bounding-set=-sys_nice " if as_root else ""
    polite.write_text(f'#!/bin/sh\nexec {humble}nice -n 10 {CHROMIUM} "$@"\n', encoding="ascii")
    polite.chmod(0o700)
    sandbox = ["--no-sandbox"] if as_root else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(polite), args=[*FLAGS, *sandbox])
        try:
            yield browser
        finally:
            browser.close()


class Viewer:
    """One browser window on the page; keeps what went wrong in it."""

    def __init__(self, browser: Browser, url: str, size: tuple[int, int] = (1100, 660)) -> None:
        """Opens the page and waits until it shows the arm's state."""
        self.errors: list[str] = []
        self.page: Page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(url, timeout=LOAD_MS)
        self.page.wait_for_selector(".armsight-state b", timeout=LOAD_MS)
        # viser warns of rendering without a GPU
        self.page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(x => x.click())")

    def close(self) -> None:
        """Closes the window."""
        self.page.close()

    def title(self) -> str:
        """The arm's state in a word."""
        return self.page.inner_text(".armsight-state b")

    def wait_for_title(self, *titles: str) -> None:
        """Until the arm's state is one of these."""
        words = " | ".join(titles)
        script = "titles => titles.split(' | ').includes(document.querySelector('.armsight-state b')?.innerText)"
        self.page.wait_for_function(script, arg=words, timeout=WAIT_MS)

    def wait_for_service(self, name: str, status: str) -> None:
        """Until a process is said to be so."""
        self.page.wait_for_selector(f'tr[data-service="{name}"][data-status="{status}"]', timeout=WAIT_MS)

    def status(self, service: str) -> str:
        """How a process is said to be."""
        return self.page.get_attribute(f'tr[data-service="{service}"]', "data-status", timeout=WAIT_MS) or ""

    def row(self, service: str) -> str:
        """All that is said of a process."""
        return self.page.inner_text(f'tr[data-service="{service}"]', timeout=WAIT_MS)

    def why(self) -> str:
        """The arm's state in a sentence."""
        return self.page.inner_text(".armsight-state")

    def slider(self, joint: str) -> float:
        """The angle that a slider shows, rad."""
        return float(self._number(joint).input_value(timeout=WAIT_MS))

    def set_slider(self, joint: str, angle_rad: float) -> None:
        """Types an angle beside a slider."""
        number = self._number(joint)
        number.fill(f"{angle_rad:g}", timeout=WAIT_MS)
        number.press("Enter")

    def press(self, button: str) -> None:
        """Clicks the button with this label."""
        # at once: a browser that draws slowly is long in finding out that a button does not move
        self.page.get_by_role("button", name=button, exact=True).click(timeout=WAIT_MS, force=True)

    def mode(self) -> str:
        """The mode that is shown."""
        return self._mode().input_value(timeout=WAIT_MS)

    def choose_mode(self, name: str) -> None:
        """Picks a mode from the list."""
        self._mode().click(timeout=WAIT_MS, force=True)
        self.page.get_by_role("option", name=name, exact=True).click(timeout=WAIT_MS, force=True)

    def pictures(self) -> list[str]:
        """The addresses of the cameras' pictures: each picture has a new one."""
        return [image.get_attribute("src") or "" for image in self.page.locator("img[src^='blob:']").all()]

    def drag(self, grip: Vector, to: Vector, look: tuple[Vector, Vector]) -> None:
        """Drags what is at a point of the world to another, both as seen from where a viewer stands first."""
        start, end = self._pixel(grip, look), self._pixel(to, look)
        mouse = self.page.mouse
        mouse.move(*start)
        self._draw(3)  # it notices the pointer when it draws next
        mouse.down()
        for share in np.linspace(0.1, 1.0, 8):
            mouse.move(*(start + share * (end - start)))
            self._draw(1)
        mouse.up()

    def rest(self, seconds: float) -> None:
        """Looks on for a while, and until all that was heard by then is drawn."""
        self.page.wait_for_timeout(1000 * seconds)
        self._draw(5)

    def _draw(self, frames: int) -> None:
        script = (
            "n => new Promise(done => { const next = () => n-- > 0 ? requestAnimationFrame(next) : done(); next() })"
        )
        self.page.evaluate(script, frames)

    def _number(self, joint: str) -> Locator:
        name = self.page.get_by_text(f"{joint} (rad)", exact=True)
        return name.locator("xpath=ancestor::*[.//input[@type='text']][1]").locator("input[type='text']").first

    def _mode(self) -> Locator:
        return self.page.get_by_role("combobox", name="mode")

    def _pixel(self, point: Vector, look: tuple[Vector, Vector]) -> Vector:
        eye, middle = look
        forward = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        away = point - eye
        x, y, depth = away @ right, away @ np.cross(right, forward), away @ forward
        box = self.page.locator("canvas").first.bounding_box()
        assert box is not None
        scale = box["height"] / 2 / np.tan(_FOV_RAD / 2) / depth
        return np.array([box["x"] + box["width"] / 2 + x * scale, box["y"] + box["height"] / 2 - y * scale])


def until(condition: Callable[[], bool], viewer: Viewer, what: str) -> None:
    """Waits, and lets the browser's events in meanwhile."""
    deadline = time.monotonic() + WAIT_MS / 1000
    while not condition():
        assert time.monotonic() < deadline, f"not within {WAIT_MS / 1000:g} s: {what}"
        viewer.page.wait_for_timeout(100)
