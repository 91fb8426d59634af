"""Measurements of this project on this machine: `python -m benchmarks`. Figures are reported, never asserted."""
