"""One measurement a module: `measure` runs it and returns a `Result`."""
