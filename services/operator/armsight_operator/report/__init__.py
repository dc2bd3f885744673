"""Measures the whole pipeline against the truth: the report's ten poses, its two tests, inverse kinematics, latency."""
