"""Simulation of the arm: camera frames out, joint commands in."""
