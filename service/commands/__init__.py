"""Commands of the console script that need the control process's own parts, one module each."""
