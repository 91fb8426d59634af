"""Primary and secondary interface of an e-Series controller, TCP 30001 and 30002, as bytes; no sockets.

All numbers are big-endian. A package consists of its size (4 bytes; it counts itself and the type), its type and its
content. The content is a robot state or a robot message. A robot state is a sequence of sub-packages, each with a size
and type of its own. A robot message has a time, a source and a type of its own.
"""
