"""What the cameras see, a few times a second, small, with vision's outlines and names on it."""

import logging
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from armsight.bus import Bus
from armsight.errors import ArmsightError
from armsight_operator.picture import Views, annotated

log = logging.getLogger(__name__)

Pixels = npt.NDArray[np.uint8]

PERIOD_S = 0.3
WIDTH_PX = 400

_TIMEOUT_S = 1.0
# Frames without annotations are better than none: vision is away then, and the page says so.
_BARE_AFTER_S = 0.4


class Pictures:
    """Takes pictures until :meth:`close`, in a thread of its own.

    Args:
        bus: where they are.
        cameras: tells their names; none yet, no pictures.
        show: takes a camera's name and its picture.
    """

    def __init__(self, bus: Bus, cameras: Callable[[], Sequence[str]], show: Callable[[str, Pixels], None]) -> None:
        """Starts the thread."""
        self._cameras = cameras
        self._show = show
        self._done = threading.Event()
        self._views = Views(bus)
        self._thread = threading.Thread(target=self._work, name="pictures", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leaves frames and annotations alone."""
        self._done.set()
        self._thread.join(timeout=_TIMEOUT_S + PERIOD_S)
        self._views.close()

    def _work(self) -> None:
        while not self._done.is_set():
            began = time.monotonic()
            if cameras := self._cameras():
                self._take(cameras)
            self._done.wait(max(0.05, PERIOD_S - (time.monotonic() - began)))

    def _take(self, cameras: Sequence[str]) -> None:
        try:
            for view in self._views.take(cameras, _TIMEOUT_S, _BARE_AFTER_S):
                self._show(view.camera, np.asarray(annotated(view, WIDTH_PX)))
        except (ArmsightError, ValueError) as error:  # the services' health says what is missing
            log.debug("no pictures: %s", error)
        except Exception:
            log.exception("taking pictures failed")
