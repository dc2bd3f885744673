"""Draws every figure of the explanation: `make docs-figures`, or `python docs/figures/draw.py [FOLDER]`.

Each module beside this one belongs to a page: ``FIGURES`` draws its figures from the code that the services run on,
``facts`` states what the page says in numbers, in its words. A test holds figures and pages to them.
"""

import sys
from pathlib import Path

import figure_estimation
import figure_geometry
import figure_kinematics
import figure_motion
import figure_vision
import paper

# Page of docs/explanation → what it states and shows.
PAGES = {
    "geometry": figure_geometry,
    "vision": figure_vision,
    "estimation": figure_estimation,
    "kinematics": figure_kinematics,
    "motion": figure_motion,
}


def draw(folder: Path) -> None:
    """Writes all of them."""
    for page in PAGES.values():
        for name, drawn in page.FIGURES.items():
            paper.save(drawn(), folder / f"{name}.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else paper.IMAGES)
