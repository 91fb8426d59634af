"""The one command, `dsl-assembly`: every group and command by name, each loaded when it is asked for."""
