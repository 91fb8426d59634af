"""Parser from the text of a script to its syntax tree.

The grammar is `grammar.lark`, parsed bottom-up without recursion, so memory grows with the length of the text only, not
with its depth.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from lark import Lark, Token, Transformer, UnexpectedInput
from lark.visitors import v_args  # pyright: ignore[reportUnknownVariableType]  # half annotated

from .errors import CompileError
from .syntax import (
    Argument,
    Assign,
    Binary,
    Block,
    Call,
    CallStatement,
    Constant,
    Expression,
    Field,
    Function,
    If,
    Index,
    ListLiteral,
    Name,
    OnThread,
    Parameter,
    Place,
    Return,
    Simple,
    Statement,
    Unary,
    While,
)
from .values import LARGEST_INT, LONGEST_TEXT

LONGEST_SOURCE = 131_072
"""Characters; three times the longest script of a client in use. Compiling delays the tick, by up to 2 s."""
LONGEST_QUOTE = 200


@lru_cache(maxsize=2)
def parse(text: str) -> Block:
    """Return the statements of a script.

    Raises:
        CompileError: the text is not URScript, or longer than `LONGEST_SOURCE`.
    """
    if len(text) > LONGEST_SOURCE:
        raise CompileError(0, 0, f"The script has {len(text)} characters, the most is {LONGEST_SOURCE}: split it")
    try:
        return _PARSER.parse(text)  # type: ignore[return-value]  # the transformer makes a block of the tree
    except UnexpectedInput as error:
        raise _syntax_error(error, text) from None


def _syntax_error(error: UnexpectedInput, text: str) -> CompileError:
    # A text that ends too early has the place of its last word.
    source = text.split("\n")[error.line - 1].strip()[:LONGEST_QUOTE]
    return CompileError(error.line, error.column, f"syntax_error_on_line:{error.line}:{source}:")


def _place(token: Token) -> Place:
    return token.line or 0, token.column or 0


@dataclass(frozen=True, slots=True)
class _Branch:
    condition: Expression
    block: Block


@v_args(inline=True)
class _TreeBuilder(Transformer[Token, Block]):
    def start(self, *statements: Statement) -> Block:
        return statements

    def block(self, *statements: Statement) -> Block:
        return statements

    # expressions

    def name(self, token: Token) -> Name:
        return Name(_place(token), str(token))

    def number(self, token: Token) -> Constant:
        text = str(token)
        if text[:2] in ("0x", "0X"):
            if len(text) > 10:
                raise _at(token, "Integer literals have 32 bits")
            number = int(text, 16)
            return Constant(_place(token), number - 2**32 if number > LARGEST_INT else number)
        if text.isdigit() and len(text) <= 10 and int(text) <= LARGEST_INT:
            return Constant(_place(token), int(text))
        return Constant(_place(token), float(text))

    def string(self, token: Token) -> Constant:
        if len(token) - 2 > LONGEST_TEXT:
            raise _at(token, f"A string cannot have more than {LONGEST_TEXT} characters")
        return Constant(_place(token), str(token)[1:-1])

    def boolean(self, word: Token) -> Constant:
        return Constant(_place(word), word == "True")

    def list_(self, bracket: Token, *items: Expression) -> ListLiteral:
        return ListLiteral(_place(bracket), items)

    def index(self, base: Expression, _bracket: Token, *items: Expression) -> ListLiteral | Index:
        # `p` is a name like any other; only the number of items tells a pose from an element of the variable p.
        if isinstance(base, Name) and base.name == "p" and len(items) == 6:
            return ListLiteral(base.place, items, pose=True)
        return Index(base.place, base, items)

    def field(self, base: Expression, name: Token) -> Field:
        return Field(_place(name), base, name[1:].strip())

    def named(self, name: Token, value: Expression) -> Argument:
        return Argument(_place(name), str(name), value)

    def positional(self, value: Expression) -> Argument:
        return Argument(value.place, "", value)

    def call(self, name: Token, *arguments: Argument) -> Call:
        return Call(_place(name), str(name), arguments)

    def method(self, base: Expression, name: Token, *arguments: Argument) -> Call:
        return Call(_place(name), name[1:].strip(), arguments, base=base)

    def run(self, keyword: Token, name: Token, *arguments: Argument) -> Call:
        return Call(_place(keyword), str(name), arguments, thread=True)

    def unary(self, operator: Token, operand: Expression) -> Unary:
        return Unary(_place(operator), str(operator), operand)

    def binary(self, left: Expression, operator: Token, right: Expression) -> Binary:
        return Binary(_place(operator), str(operator), left, right)

    # statements

    def call_statement(self, call: Expression) -> CallStatement:
        if not isinstance(call, Call):
            raise CompileError(*call.place, "A statement must do something: assign, call or control the flow")
        return CallStatement(call.place, call)

    def assign(self, target: Expression, value: Expression) -> Assign:
        if not isinstance(target, Name | Index | Field):
            raise CompileError(*target.place, "Only a variable, an element or a field of one can be assigned")
        return Assign(target.place, target, value)

    def qualified(self, qualifier: Token, name: Token, value: Expression) -> Assign:
        return Assign(_place(name), self.name(name), value, "global" if qualifier == "global" else "local")

    def branch(self, condition: Expression, block: Block) -> _Branch:
        return _Branch(condition, block)

    def if_(self, keyword: Token, *parts: _Branch | Block) -> If:
        branches = tuple((part.condition, part.block) for part in parts if isinstance(part, _Branch))
        last = parts[-1]
        return If(_place(keyword), branches, () if isinstance(last, _Branch) else last)

    def while_(self, keyword: Token, condition: Expression, body: Block) -> While:
        return While(_place(keyword), condition, body)

    def return_(self, keyword: Token, value: Expression | None = None) -> Return:
        return Return(_place(keyword), value)

    def simple(self, keyword: Token) -> Simple:
        return Simple(_place(keyword), str(keyword))

    def on_thread(self, keyword: Token, handle: Expression) -> OnThread:
        return OnThread(_place(keyword), str(keyword), handle)

    def parameter(self, name: Token, default: Expression | None = None) -> Parameter:
        return Parameter(_place(name), str(name), default)

    def function(self, keyword: Token, name: Token, *rest: Any) -> Function:
        *parameters, body = rest
        return Function(_place(name), str(keyword), str(name), tuple(parameters), body)


def _at(token: Token, text: str) -> CompileError:
    return CompileError(*_place(token), text)


_PARSER: Final = Lark(
    Path(__file__).with_name("grammar.lark").read_text(encoding="utf-8"),
    parser="lalr",
    lexer="basic",  # every keyword is reserved in every place
    maybe_placeholders=False,
    transformer=_TreeBuilder(),
)
_PARSER.parse("first = 1")  # this also makes the scanner, so no tick of a controller waits for either
