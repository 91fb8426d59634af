"""The HTTP API of one cell. It has no authority over motion beyond sending commands to the control process."""
