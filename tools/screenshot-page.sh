#!/usr/bin/env bash
# Makes docs/images/page.png from the running system: a stack of its own, and the page in a headless Chromium.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/install-apt-packages.sh tools/apt-packages-browser.txt
PYTHONPATH=tests .venv/bin/python - <<'PYTHON'
import tempfile
from pathlib import Path

from armsight_operator.stack import PAGE, Stack
from browser import Viewer, chromium
from rig import Rig

folder = Path(tempfile.mkdtemp(prefix="armsight-"))
rig = Rig(Stack(out=folder, target="default", mode="track", fps=15, page_port=0))
try:
    rig.start_all()
    rig.start(PAGE)
    rig.wait_ready(120)
    with chromium(folder) as browser:
        viewer = Viewer(browser, f"http://127.0.0.1:{rig.stack.page_port}", (1440, 900))
        viewer.wait_for_title("Moving")
        viewer.page.wait_for_timeout(30_000)  # until the plots are full
        viewer.page.screenshot(path="docs/images/page.png", timeout=120_000)
finally:
    rig.close()
print("docs/images/page.png is new")
PYTHON
