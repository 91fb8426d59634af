"""Measurements of this project on one machine: `dsl-assembly bench`. Figures are reported, never asserted."""
