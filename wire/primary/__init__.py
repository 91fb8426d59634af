"""Primary and secondary interface of an e-Series controller, TCP 30001 and 30002, as bytes; no sockets.

Everything is big-endian. A package is its size (4 bytes, these and the type included), its type and its content: a
robot state, which is a row of sub-packages with size and type again, or a robot message, which has a time, a source and
a type of its own.
"""
