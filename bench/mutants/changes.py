"""The changes that are tried of a file: one place of its syntax tree at a time. Pure.

A comparison moves its boundary or is negated, `and` becomes `or`, an operator becomes its opposite, a number another, True
becomes False, a condition is negated, nothing is returned, a statement is gone. Words, annotations and decorators stay.
"""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, NamedTuple

MODULE: Final = "<module>"  # what runs when the file is imported: tables, defaults, bodies of classes
COMPARED: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
COMPUTED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
SIGNS: Final = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Is: "is",
    ast.IsNot: "is not",
    ast.In: "in",
    ast.NotIn: "not in",
    ast.And: "and",
    ast.Or: "or",
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.Pow: "**",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.BitXor: "^",
    ast.LShift: "<<",
    ast.RShift: ">>",
}
UNCHANGED: Final = {"annotation", "returns", "decorator_list", "type_params"}
SHOWN: Final = 40  # characters of what changes, in the name of a change

Function = ast.FunctionDef | ast.AsyncFunctionDef
Put = Callable[[ast.AST], None]  # another node in the place of this one


class Place(NamedTuple):
    node: ast.AST
    put: Put
    function: str
    line: int  # of the statement


class Change(NamedTuple):
    """One change: `make` does it to the tree that it was found in."""

    function: str  # as its code names itself, or MODULE
    asks: frozenset[str]  # the functions whose tests may notice it: of a table, those that use its name
    line: int
    end: int
    name: str  # function | text of the line | what changes: the same wherever the line stands in the file
    make: Callable[[], None]


def changes(source: str) -> tuple[ast.Module, list[Change]]:
    """The tree of a file, and all changes of it, in an order that depends on the file alone."""
    tree, lines, known, found = ast.parse(source), source.splitlines(), Counter[str](), list[Change]()
    users = _users(tree)
    for place in _places(tree, MODULE, 0):
        for what, make in _of(place):
            line = getattr(place.node, "lineno", place.line)
            name = f"{place.function} | {lines[line - 1].strip()} | {what}"
            known[name] += 1
            again = f" ({known[name]})" if known[name] > 1 else ""
            asks = users.get(line) if place.function == MODULE else None
            asks = asks or frozenset({place.function})
            found.append(Change(place.function, asks, line, getattr(place.node, "end_lineno", line), name + again, make))
    return tree, found


def changed(source: str, number: int) -> ast.Module:
    """The tree of a file after one of its changes."""
    tree, found = changes(source)
    found[number].make()
    return ast.fix_missing_locations(tree)


def functions(
    node: ast.AST, inside: str = "", outermost: str = ""
) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """All functions, each with the name of the outermost one that it belongs to."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            name = outermost or f"{inside}{child.name}"
            yield name, child
            yield from functions(child, inside, name)
        elif isinstance(child, ast.ClassDef) and not outermost:
            yield from functions(child, f"{inside}{child.name}.")
        else:
            yield from functions(child, inside, outermost)


def _users(tree: ast.Module) -> dict[int, frozenset[str]]:
    """By the line of what stands outside functions: the functions that use its names, and those of its class."""
    used, users = dict[str, set[str]](), dict[int, frozenset[str]]()
    for name, function in functions(tree):
        used.setdefault(name, set()).update(each.id for each in ast.walk(function) if isinstance(each, ast.Name))
    for statement in tree.body:
        own = str(getattr(statement, "name", ""))
        names = {own} | {
            each.id for each in ast.walk(statement) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
        }
        found = frozenset(name for name, uses in used.items() if uses & names or (own and name.startswith(f"{own}.")))
        users.update(dict.fromkeys(range(statement.lineno, (statement.end_lineno or statement.lineno) + 1), found))
    return users


def _places(node: ast.AST, function: str, line: int, inside: str = "") -> Iterator[Place]:
    """All that may change, with the outermost function that it belongs to; the names of its classes are before it."""
    for field, value in ast.iter_fields(node):
        if field in UNCHANGED or (isinstance(node, ast.If) and _is_of_start(node.test)):
            continue
        for index, child in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(child, ast.AST):
                continue
            put: Put = partial(value.__setitem__, index) if isinstance(value, list) else partial(setattr, node, field)
            at = child.lineno if isinstance(child, ast.stmt) else line
            yield Place(child, put, function, at)
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) and function == MODULE:
                yield from _defined(child, inside, at)
            elif isinstance(child, ast.ClassDef) and function == MODULE:
                yield from _places(child, function, at, f"{inside}{child.name}.")
            else:
                yield from _places(child, function, at, inside)


def _defined(function: Function, inside: str, line: int) -> Iterator[Place]:
    """The defaults of a function are computed when its file is imported, and its body when it is called."""
    yield from _places(function.args, MODULE, line, inside)
    for index, statement in enumerate(function.body):
        yield Place(statement, partial(function.body.__setitem__, index), f"{inside}{function.name}", statement.lineno)
        yield from _places(statement, f"{inside}{function.name}", statement.lineno)


def _is_of_start(test: ast.expr) -> bool:
    """`if __name__ == "__main__"`, `if TYPE_CHECKING`: no test imports a file that way."""
    return ast.unparse(test) in ("__name__ == '__main__'", "TYPE_CHECKING")


def _of(place: Place) -> Iterator[tuple[str, Callable[[], None]]]:
    """The changes of one place, in words and as what does them."""
    node, put, _, _ = place
    match node:
        case ast.Compare():
            for index, sign in enumerate(node.ops):
                for other in COMPARED[type(sign)]:
                    yield f"{SIGNS[type(sign)]} → {SIGNS[other]}", partial(node.ops.__setitem__, index, other())
        case ast.BoolOp():
            either = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield f"{SIGNS[type(node.op)]} → {SIGNS[type(either)]}", partial(setattr, node, "op", either)
        case ast.BinOp() | ast.AugAssign() if type(node.op) in COMPUTED:
            other_op = COMPUTED[type(node.op)]()
            yield f"{SIGNS[type(node.op)]} → {SIGNS[type(other_op)]}", partial(setattr, node, "op", other_op)
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield f"{_shown(node)} → {_shown(node.operand)}", partial(put, node.operand)
        case ast.Constant(value=bool() | int() | float()):
            value = _another(node.value)  # type: ignore[arg-type]
            yield f"{node.value!r} → {value}", partial(setattr, node, "value", value)
    yield from _negated(node)
    yield from _gone(node, put)


def _another(value: float) -> float:
    """Another number: the next, twice as much; or the other truth."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) or value == 0.0 else 2.0 * value


def _negated(node: ast.AST) -> Iterator[tuple[str, Callable[[], None]]]:
    """Conditions, unless a comparison or a `not` in the same place is negated anyhow."""
    tests = list[tuple[ast.expr, Put]]()
    if isinstance(node, ast.If | ast.While | ast.IfExp) and not _is_of_start(node.test):
        tests.append((node.test, partial(setattr, node, "test")))
    elif isinstance(node, ast.comprehension):
        tests += [(test, partial(node.ifs.__setitem__, index)) for index, test in enumerate(node.ifs)]
    for test, put in tests:
        match test:
            case ast.Compare(ops=[_]) | ast.UnaryOp(op=ast.Not()) | ast.Constant():
                continue
        yield f"not {_shown(test)}", partial(put, ast.UnaryOp(ast.Not(), test))


def _gone(node: ast.AST, put: Put) -> Iterator[tuple[str, Callable[[], None]]]:
    """Statements that are left out, and answers that are not given."""
    match node:
        case ast.Return(value=ast.expr() as value):
            if not (isinstance(value, ast.Constant) and (value.value is None or isinstance(value.value, bool))):
                yield "return None", partial(setattr, node, "value", ast.Constant(None))
        case ast.Expr(value=ast.Constant()):
            return
        case ast.Return() | ast.Raise() | ast.Continue() | ast.Break() | ast.AugAssign() | ast.Delete() | ast.Expr():
            yield f"without {_shown(node)}", partial(put, ast.Pass())
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript(), *_]):
            yield f"without {_shown(node)}", partial(put, ast.Pass())


def _shown(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 2]} …"
