"""The one form of computation: loops over an output's entries and, inside them, loops that gather a total."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from softslide.models.export.c99.tensors import Buffer, Tensor, literal, suffix

# Where a buffer lies: the C array's name, and the place of the buffer's first element in it.
Place = Callable[[Buffer], tuple[str, int]]
_Loop = tuple[int, tuple[int, ...]]  # times, and the step of every array


@dataclass(frozen=True)
class Nest:
    """out[...] = finish, each time after `update` has run over the inner loops.

    operands: each of a shape that broadcasts to that of `out` followed by `inner`. In the formulas {0}, {1}, ... are
    the operands' entries, {s} is the total and {f} what the names of math.h end in for the type of `out`.
    step, size: where given, the place of {0} is further by step * {1}, {1} being one of `size` places.
    """

    kind: str
    out: Tensor
    operands: tuple[Tensor, ...]
    finish: str
    inner: tuple[int, ...] = ()
    start: str = ""
    update: str = ""
    step: int = 0
    size: int = 0

    @property
    def reads(self) -> list[Buffer]:
        """Buffers read."""
        return [operand.buffer for operand in self.operands]

    @property
    def writes(self) -> Buffer:
        """The buffer written."""
        return self.out.buffer

    def code(self, place: Place) -> list[str]:
        """Lines of C."""
        outer = len(self.out.shape)
        shape = self.out.shape + self.inner
        target = self.out.index.reshape(self.out.shape + (1,) * len(self.inner))
        arrays = [
            (tensor.buffer, *strides(np.broadcast_to(index, shape)))
            for tensor, index in ((self.out, target), *((o, o.index) for o in self.operands))
        ]
        loops = list(zip(shape, zip(*(steps for _, _, steps in arrays), strict=True), strict=True))
        over, within = _merged(loops[:outer]), _merged(loops[outer:])
        names = [f"i{n}" for n in range(len(over) + len(within))]
        entries = [
            _entry(buffer, first, [step[n] for _, step in over + within], names, place)
            for n, (buffer, first, _) in enumerate(arrays)
        ]

        if self.step:
            buffer, first, _ = arrays[1]
            further = f"{self.step} * within({entries[2]}, {self.size})"
            entries[1] = _entry(buffer, first, [step[1] for _, step in over + within], names, place, further)

        def formula(text: str) -> str:
            return text.format(*entries[1:], s="s", f=suffix(self.out.kind))

        body = [f"{entries[0]} = {formula(self.finish)};"]
        if self.update:
            gather = _looped(within, names[len(over) :], [formula(self.update)])
            # In the numbers' own precision: a double costs a small processor twenty times as much.
            total = "float" if self.out.kind == np.float32 else "double"
            body = [f"{total} s = {self.start};", *gather, *body]
        return [f"/* {self.kind} */", *_looped(over, names, body)]


def strides(index: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """First place and steps (one an axis) of places in even steps.

    Raises:
        ValueError: the steps are uneven.
    """
    first = int(index.flat[0])
    steps = tuple(
        int(np.take(index, 1, axis).flat[0]) - first if n > 1 else 0 for axis, n in enumerate(index.shape)
    )
    even = np.full((), first)
    for n, step in zip(index.shape, steps, strict=True):
        even = even[..., None] + step * np.arange(n)
    if not np.array_equal(even, index):
        raise ValueError("uneven steps")
    return first, steps


def _merged(loops: Sequence[_Loop]) -> list[_Loop]:
    """Without loops of one turn, and two as one where every array runs on evenly."""
    merged: list[_Loop] = []
    for times, step in loops:
        if times == 1:
            continue
        if merged and all(far == near * times for far, near in zip(merged[-1][1], step, strict=True)):
            times *= merged.pop()[0]
        merged.append((times, step))
    return merged


def _looped(loops: list[_Loop], names: Sequence[str], body: list[str]) -> list[str]:
    """Loops around a body, indented; a block of its own where there is a total to declare and no loop."""
    heads = [
        f"for (int {name} = 0; {name} < {times}; {name}++)"
        for (times, _), name in zip(loops, names, strict=False)
    ]
    lines = ["    " * n + head for n, head in enumerate(heads)]
    if len(body) == 1:
        return [*lines, "    " * len(heads) + body[0]]
    depth = max(len(heads) - 1, 0)
    lines = [*lines[:-1], lines[-1] + " {"] if lines else ["{"]
    return [*lines, *("    " * (depth + 1) + line for line in body), "    " * depth + "}"]


def _entry(
    buffer: Buffer, first: int, steps: list[int], names: list[str], place: Place, further: str = ""
) -> str:
    """An array's entry inside the loops; a constant that is the same in all of them by its value."""
    if buffer.value is not None and not any(steps) and not further:
        number = literal(buffer.value[first])
        return f"({number})" if number.startswith("-") else number
    array, begin = place(buffer)
    if buffer.name and buffer.size == 1:
        return array
    terms = [
        name if step == 1 else f"{step} * {name}" for step, name in zip(steps, names, strict=True) if step
    ]
    terms += [further] if further else []
    if first + begin or not terms:
        terms.append(str(first + begin))
    return f"{array}[{' + '.join(terms)}]"
