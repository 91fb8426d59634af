"""One measurement per module: `measure` runs it and returns a `Result`."""
