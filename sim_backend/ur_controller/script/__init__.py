"""URScript: compiled to Python code and run in steps of one tick.

The language is that of UR's script manual for PolyScope 5 (universal-robots.com/manuals, SW5_25_1, prod-scriptmanual).
Where the manual leaves a question open, the module that answers it states the answer and the reason.
"""

from .builtin import REQUIRED, Builtin, Parameter, Table
from .compiler import Compiled, compile_source
from .errors import CompileError, Halt, ScriptRuntimeError
from .runtime import Execution, ScriptThread, State
from .values import Pose, Struct, Value

__all__ = [
    "REQUIRED",
    "Builtin",
    "CompileError",
    "Compiled",
    "Execution",
    "Halt",
    "Parameter",
    "Pose",
    "ScriptRuntimeError",
    "ScriptThread",
    "State",
    "Struct",
    "Table",
    "Value",
    "compile_source",
]
