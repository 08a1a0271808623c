"""Random faults in product code: one small change at a place that a seed draws, as a programmer might make it by mistake.

Comparison turned or off by one at its edge, number changed by one, flag flipped, operator or ``and`` changed, condition negated,
value not returned, statement deleted, two arguments swapped. Words, annotations and decorators stay.
"""

from __future__ import annotations

import ast
import random
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tests.mutations.blocks import nodes
from tests.mutations.faults import ROOT

EQUIVALENT = Path(__file__).with_name("equivalent.toml")
TURNED: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.GtE), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,), ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,), ast.FloorDiv: (ast.Div,), ast.Mod: (ast.FloorDiv,), ast.Pow: (ast.Mult,), ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,), ast.LShift: (ast.RShift,), ast.RShift: (ast.LShift,),
}  # fmt: skip

Key = tuple[str, str, str, str, int]

SYMMETRIC = {
    "max", "min", "np.maximum", "np.minimum", "np.array_equal", "math.hypot", "np.hypot", "hmac.compare_digest", "suppress",
}  # fmt: skip
"""Functions whose arguments have no order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """One possible fault.

    Args:
        file: from the top of the checkout.
        line: where it stands, from 1.
        block: name of the block that holds it, as `tests.mutations.blocks` has it; empty outside of functions.
        start, end: bytes of the file that it replaces.
        new: by what.
        old: what stands there.
        nth: which it is, from 0, of those that say the same in the block.
    """

    file: str
    line: int
    block: str
    start: int
    end: int
    old: str
    new: str
    nth: int = 0

    @property
    def room(self) -> str:
        """The room of the file: one of hil, or one of the other packages."""
        package, *room = Path(self.file).parts[:-1]
        return f"hil/{room[0]}" if package == "hil" and room else package

    def put_into(self, text: str) -> str:
        """Return the file's text with the fault in it."""
        raw = text.encode()
        return (raw[: self.start] + self.new.encode() + raw[self.end :]).decode()

    @property
    def words(self) -> tuple[str, str]:
        """What stands there and what replaces it, on a line each."""
        return " ".join(self.old.split()), " ".join(self.new.split())

    @property
    def key(self) -> Key:
        """What stays the same while other code moves: file, block, words and which of those that say the same."""
        return self.file, self.block, *self.words, self.nth

    def __str__(self) -> str:
        return f"{self.file}:{self.line}  {'  ->  '.join(self.words)}"


def places(file: str, text: str) -> list[Place]:
    """Return every fault that a file can have."""
    tree, raw = ast.parse(text), text.encode()
    starts = [0]
    for line in raw.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    kept = {id(node) for part in _parts_that_stay(tree) for node in ast.walk(part)}
    found: list[Place] = []
    same: dict[Key, int] = defaultdict(int)
    for node, block in nodes(tree):
        if id(node) in kept:
            continue
        for at, new in _faults(node):
            start, end = starts[at.lineno - 1] + at.col_offset, starts[at.end_lineno - 1] + at.end_col_offset
            new = f"({new})" if isinstance(at, ast.expr) else new
            place = Place(file=file, line=at.lineno, block=block, start=start, end=end, old=raw[start:end].decode(), new=new)
            found.append(replace(place, nth=same[place.key]))
            same[place.key] += 1
    return found


def _parts_that_stay(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield what says nothing while it runs, and f-strings, whose parts have no place of their own before Python 3.12."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield node
        elif isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            yield node.annotation
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from node.decorator_list
            if not isinstance(node, ast.ClassDef) and node.returns:
                yield node.returns
        elif isinstance(node, ast.If | ast.Assign):
            head = node.test if isinstance(node, ast.If) else node.targets[0]
            if isinstance(head, ast.Name) and head.id in ("TYPE_CHECKING", "__all__"):
                yield node


def _faults(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Yield what of a node can be replaced by which text."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for op in TURNED[type(node.ops[0])]:
            yield node, ast.unparse(ast.Compare(node.left, [op()], node.comparators))
    elif isinstance(node, ast.BinOp) and type(node.op) in TURNED:
        yield node, ast.unparse(ast.BinOp(node.left, TURNED[type(node.op)][0](), node.right))
    elif isinstance(node, ast.BoolOp):
        yield node, ast.unparse(ast.BoolOp(TURNED[type(node.op)][0](), node.values))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield node, str(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        if node.value + 1 != node.value:  # 1e60 + 1 is 1e60
            yield node, repr(node.value + 1)
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield node.test, f"not ({ast.unparse(node.test)})"
    elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != "None":
        yield node, "return None"
    elif isinstance(node, ast.AugAssign | ast.Raise) or _calls(node) or _changes_what_is_there(node):
        yield node, "pass"
    elif isinstance(node, ast.Call) and len(node.args) > 1 and not any(isinstance(arg, ast.Starred) for arg in node.args[:2]):
        first, second, *others = node.args
        if ast.dump(first) != ast.dump(second) and ast.unparse(node.func) not in SYMMETRIC:
            yield node, ast.unparse(ast.Call(node.func, [second, first, *others], node.keywords))


def _calls(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)


def _changes_what_is_there(node: ast.AST) -> bool:
    """Whether a deleted assignment leaves something behind: what else is a name that is missing fails wherever it runs."""
    if not isinstance(node, ast.Assign):
        return False
    read = {name.id for name in ast.walk(node.value) if isinstance(name, ast.Name)}
    return all(not isinstance(to, ast.Name) or to.id in read for to in node.targets)


def drawn(files: Sequence[str], number: int, seed: int, root: Path = ROOT) -> list[Place]:
    """Return faults drawn at random: each room has a share by its size, two at least.

    The rooms take turns, so that the first of the faults are a sample too.
    """
    rooms: Mapping[str, list[Place]] = defaultdict(list)
    for file in files:
        for place in places(file, (root / file).read_text()):
            rooms[place.room].append(place)
    rng = random.Random(seed)
    total = sum(map(len, rooms.values()))
    keyed = []
    for _, found in sorted(rooms.items()):
        share = min(len(found), max(2, round(number * len(found) / total)))
        keyed += [((n + rng.random()) / share, place) for n, place in enumerate(rng.sample(found, share))]
    return [place for _, place in sorted(keyed, key=lambda each: each[0])]


def equivalent() -> set[Key]:
    """Return the faults that change nothing that a user or a test could see."""
    table = tomllib.loads(EQUIVALENT.read_text()).get("fault", [])
    return {(each["file"], each["block"], each["old"], each["new"], each.get("nth", 0)) for each in table if each["why"]}
