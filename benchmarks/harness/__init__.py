"""What every measurement uses: processes, clocks, results and their tables."""
