"""Measurements of this project on one machine: `python -m benchmarks`. Figures are reported, never asserted."""
