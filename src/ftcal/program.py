"""A traced formula as LLVM IR: a straight-line function of vectors for each section (limb).

Scratch memory has a row for each input, each value one section needs of another, and each output;
`ftcal.tiles` brings samples there and wrenches back.
"""

from __future__ import annotations

from ftcal.sincos import sin_cos_ir, splat
from ftcal.tiles import BLOCK_HEAD, DRIVER, FETCH, PUT, ROW, SECTION, TILE, transpose
from ftcal.trace import Node, Number, Trace, Value


class Program:
    """A trace and its layout in the scratch."""

    def __init__(self, trace: Trace, outputs: list[Number], width: int) -> None:
        self.nodes, self.outputs, self.width = trace.nodes, outputs, width
        self.vector = f"<{width} x double>"
        self.sections: dict[int, list[int]] = {}
        """Nodes each section computes; sections come in the order of the trace."""
        self.row: dict[int, int] = {}
        """Scratch row of each input and of each value that another section needs."""
        alive = trace.needed(outputs)
        taken = 0
        for index, node in enumerate(self.nodes):
            if node.kind == "input":
                self.row[index] = int(node.operands[0])
                taken = max(taken, self.row[index] + 1)
            elif alive[index]:
                self.sections.setdefault(node.section, []).append(index)
        self.sections = self.sections or {0: []}
        for index, node in enumerate(self.nodes):
            operands = node.operands if alive[index] and node.kind != "input" else ()
            for operand in operands:
                elsewhere = isinstance(operand, int) and operand not in self.row
                if elsewhere and self.nodes[int(operand)].section != node.section:
                    self.row[int(operand)] = taken
                    taken += 1
        self.results = taken
        """First row of the outputs."""
        self.rows = taken + len(outputs)

    def text(self) -> str:
        """Return the module: a function a section, and `wrenches`, which runs them tile by tile."""
        width = self.width
        call = "  call void @section{}(ptr %scratch, i64 %m, ptr %ahead, i64 %stop)"
        clamp = (
            "  %c{k} = add i64 %b_from, {k}\n"
            "  %r{k} = call i64 @llvm.umin.i64(i64 %c{k}, i64 %final)"
        )
        driver = DRIVER.format(
            tile=TILE,
            row=ROW,
            width=width,
            ramp=f"<{', '.join(f'i64 {k}' for k in range(width))}>",
            block_words=BLOCK_HEAD + width,
            clamps="\n".join(clamp.format(k=k) for k in range(width)),
            transpose=transpose(width),
            calls="\n".join(call.format(section) for section in self.sections),
            results=self.results * ROW,
            sensors=len(self.outputs) // 6,
            puts="\n".join(PUT.format(c=c, row=c * ROW) for c in range(6)),
        )
        functions = [self._section(section) for section in self.sections]
        return "\n".join([sin_cos_ir(width), *functions, driver])

    def _section(self, section: int) -> str:
        lines = _Lines(self)
        for index in self.sections[section]:
            lines.operation(index)
        last = list(self.sections)[-1]
        for k, value in enumerate(self.outputs):
            if not isinstance(value, Value):
                if section == last:
                    lines.store(self.results + k, splat(value, self.width))
                continue
            node = self.nodes[value.id]
            if section == (last if node.kind == "input" else node.section):
                lines.store(self.results + k, lines.operand(value.id))
        return SECTION.format(
            section=section,
            number=list(self.sections).index(section),
            width=self.width,
            fetches="\n".join(FETCH.format(c=c, d=c + 1) for c in range(self.width)),
            body="\n".join(lines.lines),
        )


class _Lines:
    """Instructions of one section's loop."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.lines: list[str] = []
        self.here: set[int] = set()
        """Nodes whose value is in a register."""
        self.angles: set[int] = set()

    def operand(self, index: int) -> str:
        """Return the register of a node; one from elsewhere is loaded at first use."""
        if index not in self.here:
            self.here.add(index)
            row, align = self.program.row[index], 8 * self.program.width
            self.lines += [
                f"  %p{index} = getelementptr double, ptr %at, i64 {row * ROW}",
                f"  %v{index} = load {self.program.vector}, ptr %p{index}, align {align}",
            ]
        return f"%v{index}"

    def store(self, row: int, register: str) -> None:
        """Write a register to a row of the scratch."""
        pointer, align = f"%s{len(self.lines)}", 8 * self.program.width
        self.lines += [
            f"  {pointer} = getelementptr double, ptr %at, i64 {row * ROW}",
            f"  store {self.program.vector} {register}, ptr {pointer}, align {align}",
        ]

    def operation(self, index: int) -> None:
        """Append the instruction of a node, and the store if another section needs it."""
        node = self.program.nodes[index]
        self.lines.append(f"  %v{index} = {self._instruction(node)}")
        self.here.add(index)
        if index in self.program.row:
            self.store(self.program.row[index], f"%v{index}")

    def _instruction(self, node: Node) -> str:
        vector = self.program.vector
        first = int(node.operands[0])
        a = self.operand(first)
        if node.kind in ("sin", "cos"):
            both = f"{{{vector}, {vector}}}"
            if first not in self.angles:
                self.angles.add(first)
                self.lines.append(f"  %t{first} = call {both} @sin_cos({vector} {a})")
            return f"extractvalue {both} %t{first}, {int(node.kind == 'cos')}"
        if node.kind == "neg":
            return f"fneg contract {vector} {a}"
        second = node.operands[1]
        b = self.operand(second) if isinstance(second, int) else splat(second, self.program.width)
        name = {"add": "fadd", "shift": "fadd", "sub": "fsub", "mul": "fmul", "scale": "fmul"}
        return f"{name[node.kind]} contract {vector} {a}, {b}"
