"""Calibrating real cameras: lenses from a board, poses from the arm's own markers, and the markers' colours.

Whatever is found goes into `calibration.json` (:mod:`armsight.calibration`), and only where the pictures determine it.
Needs the extra `calibrate` of this package, which brings OpenCV.
"""
