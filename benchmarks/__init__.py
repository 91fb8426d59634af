"""Measurements of this project on this machine: `dsl-assembly bench`. Figures are reported, never asserted."""
