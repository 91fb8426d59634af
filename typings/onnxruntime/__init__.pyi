"""ONNX Runtime ships without `py.typed` and half annotated: what comes out of it is checked where it enters."""

from typing import Any

def __getattr__(name: str) -> Any: ...
