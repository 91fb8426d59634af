"""Tools shared by all measurements: processes, clocks, results and their tables."""
