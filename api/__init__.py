"""The HTTP face of one cell: no authority over motion beyond sending commands to its control process."""
