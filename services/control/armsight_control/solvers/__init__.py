"""Inverse kinematics: pure functions of a problem."""
