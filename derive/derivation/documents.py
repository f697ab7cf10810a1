"""A derivation as a person reads it: one list of sections, printed as Markdown, LaTeX or JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass

import sympy as sp
from pfaffian.derive.derivation.derive import Derivation
from pfaffian.derive.mechanics.hurwitz import HurwitzCondition, relation
from pfaffian.derive.mechanics.zero_dynamics import ZeroDynamics
from pfaffian.derive.spec.model_spec import ModelSpec
from sympy.printing.latex import LatexPrinter


@dataclass(frozen=True)
class Equation:
    """One displayed equation: what it is, its LaTeX and its plain text."""

    caption: str
    latex: str
    text: str


@dataclass(frozen=True)
class Section:
    """A heading with its equations."""

    heading: str
    equations: tuple[Equation, ...]


#: Makes an equation of a caption, the LaTeX of its left side, its right side and the plain left.
_Maker = Callable[[str, str, sp.Basic, str], Equation]


class _Names(LatexPrinter):  # type: ignore[misc]
    """Prints q' as a dotted letter and parameters by their declared LaTeX."""

    def __init__(self, names: dict[str, str]) -> None:
        super().__init__({"fold_short_frac": False})
        self._names = names

    def _print_Symbol(  # noqa: N802  (SymPy dispatches on this name)
        self, expr: sp.Symbol, style: str = "plain"
    ) -> str:
        return self._names.get(expr.name) or str(super()._print_Symbol(expr, style))


def _printer(spec: ModelSpec, zeros: ZeroDynamics) -> _Names:
    names = {p.name: p.latex for p in spec.parameters if p.latex}
    names |= {
        s.name: f"\\delta_{{{sp.latex(sp.Symbol(s.name.removeprefix('damping_')))}}}"
        for s, _ in zeros.slopes
    }
    for c in spec.coordinates:
        letter, below, index = sp.latex(c.position).partition("_")
        names[c.velocity.name] = f"\\dot{{{letter}}}{below}{index}"
    return _Names(names)


def symbol_printer(derivation: Derivation) -> LatexPrinter:
    """Return what prints expressions of `derivation` in LaTeX, as its documents do."""
    return _printer(derivation.spec, derivation.zero_dynamics)


def sections(derivation: Derivation) -> tuple[Section, ...]:
    """Return the whole derivation in reading order."""
    printer = _printer(derivation.spec, derivation.zero_dynamics)

    def equation(caption: str, symbol: str, value: sp.Basic, plain: str) -> Equation:
        return Equation(
            caption, f"{symbol} = {printer.doprint(value)}", f"{plain} = {_text(value)}"
        )

    zeros = derivation.zero_dynamics
    return (
        Section("Energies", _energies(derivation, equation, printer)),
        Section("Dynamics, (1)", _dynamics(derivation, equation)),
        Section("Servo-constraint, (2)-(8)", _constraint(derivation, equation)),
        Section("Control law, (15)-(23)", _law(derivation, printer)),
        *_swing_up(derivation, printer),
        Section("Uncertainty decomposition, (9)-(12)", _decomposition(derivation, equation)),
        Section(
            "Zero dynamics at the setpoint",
            (*_zero_dynamics(zeros, equation, printer), *_cyclic(zeros)),
        ),
        Section("Hurwitz conditions", _hurwitz(derivation, printer)),
        Section("Singular set, ADB = 0", (_singular_set(derivation, printer),)),
        Section(
            "Identities proved",
            tuple(
                Equation(f"{i.name}: {'proved' if i.proved else 'NOT proved'}", i.latex, i.name)
                for i in derivation.identities
            ),
        ),
    )


def _energies(derivation: Derivation, equation: _Maker, printer: _Names) -> tuple[Equation, ...]:
    dynamics = derivation.dynamics
    return (
        equation("kinetic energy", "T", dynamics.kinetic_energy, "T"),
        equation("potential energy", "V", dynamics.potential_energy, "V"),
        *(
            equation("lumped parameter", printer.doprint(s), e, s.name)
            for s, e in derivation.spec.lumping
        ),
    )


def _dynamics(derivation: Derivation, equation: _Maker) -> tuple[Equation, ...]:
    dynamics = derivation.dynamics
    coriolis = "Coriolis and centripetal matrix (Christoffel)"
    return (
        equation("mass matrix", "M", dynamics.mass_matrix, "M"),
        equation(coriolis, "C", dynamics.coriolis_matrix, "C"),
        equation("gravity", "G", dynamics.gravity, "G"),
        equation("input matrix", "B", dynamics.input_matrix, "B"),
    )


def _constraint(derivation: Derivation, equation: _Maker) -> tuple[Equation, ...]:
    constraint = derivation.constraint
    return (
        *_rows(equation, "residual, (3)", "s", constraint.residual),
        equation("constraint matrix, (7)", "A", constraint.jacobian, "A"),
        *_rows(equation, "right-hand side of A q'' = b, (7)", "b", constraint.acceleration),
        equation("input gain, (10)", "ADB", derivation.input_gain, "ADB"),
    )


def _decomposition(derivation: Derivation, equation: _Maker) -> tuple[Equation, ...]:
    split = derivation.decomposition
    return (
        equation("matched part", "\\hat F", split.matched, "Fhat"),
        equation("mismatched part", "\\Delta\\tilde F", split.mismatched, "dF"),
    )


def _zero_dynamics(zeros: ZeroDynamics, equation: _Maker, printer: _Names) -> Iterator[Equation]:
    degree = len(zeros.coefficients) - 1
    for k, c in enumerate(zeros.coefficients):
        power = degree - k
        yield equation(f"coefficient of p^{power}", f"a_{power}", c, f"a{power}")
    for s, e in zeros.entries:
        yield equation("entry of the linearisation", printer.doprint(s), e, s.name)
    third = len(zeros.wanted) == 3
    caption = "gain for p^3 + c2 p^2 + c1 p + c0" if third else "gain from poles"
    for s, e in zeros.gains:
        yield equation(caption, printer.doprint(s), e, s.name)


def _singular_set(derivation: Derivation, printer: LatexPrinter) -> Equation:
    numerator = sp.fraction(derivation.input_gain)[0]
    return Equation(
        "numerator of ADB", f"{printer.doprint(numerator)} = 0", f"{_text(numerator)} = 0"
    )


def _cyclic(zeros: ZeroDynamics) -> tuple[Equation, ...]:
    """Return what divides the polynomial for cyclic coordinates, and what each of them means."""
    if not zeros.at_origin:
        return ()
    power = f"p^{zeros.at_origin}"
    text = "; ".join(d.text for d in zeros.cyclic)
    return (Equation(f"divides it without friction: {text}", f"p^{{{zeros.at_origin}}}", power),)


def _hurwitz(derivation: Derivation, printer: _Names) -> tuple[Equation, ...]:
    """Return the conditions for stable zero dynamics, where a_n is not 0."""
    found = derivation.hurwitz
    if not found.closed:
        names = reversed(range(found.degree + 1))
        return (
            Equation(
                f"no closed form is given for degree {found.degree}: Routh's array of the "
                "coefficients decides, in numbers",
                " + ".join(f"a_{{{k}}} p^{{{k}}}" for k in names),
                " + ".join(f"a{k}*p^{k}" for k in reversed(range(found.degree + 1))),
            ),
        )
    return (
        *(_condition("without friction", c, printer) for c in found.frictionless),
        *(_condition("with friction", c, printer) for c in found.damped),
        *(
            Equation(
                "slope of friction at rest",
                f"{printer.doprint(s)} = {printer.doprint(e)}",
                f"{s.name} = {_text(e)}",
            )
            for s, e in (derivation.zero_dynamics.slopes if found.damped else ())
        ),
    )


def _condition(where: str, condition: HurwitzCondition, printer: _Names) -> Equation:
    left, sign, right = relation(condition.margin)
    never = ", which never holds" if condition.never else ""
    return Equation(
        f"{where}, {condition.says}{never}",
        f"{printer.doprint(left)} {sign} {printer.doprint(right)}",
        f"{left} {sign} {right}",
    )


def _rows(
    equation: _Maker,
    caption: str,
    letter: str,
    column: sp.Matrix,
) -> tuple[Equation, ...]:
    """Return one equation a servo-constraint, numbered where there are several."""
    if len(column) == 1:
        return (equation(caption, letter, column[0], letter),)
    return tuple(
        equation(caption, f"{letter}_{k}", value, f"{letter}{k}")
        for k, value in enumerate(column, 1)
    )


def _law(derivation: Derivation, printer: _Names) -> tuple[Equation, ...]:
    """Return the continuous law as its named definitions, and the sampled law's own steps."""
    rows: list[Equation] = []
    for block in ("continuous", "step"):
        for d in derivation.block(block).definitions:
            what = f"{'sampled: ' if block == 'step' else ''}{d.description}"
            shown = f"\\mathrm{{{d.symbol.name.replace('_', chr(92) + '_')}}}"
            row = Equation(
                what,
                f"{shown} = {printer.doprint(d.expression)}",
                f"{d.symbol.name} = {_text(d.expression)}",
            )
            if row.text not in {r.text for r in rows}:
                rows.append(row)
    return tuple(rows)


def _swing_up(derivation: Derivation, printer: _Names) -> tuple[Section, ...]:
    """Return the energy swing-up law as its named definitions, and what its gains must keep."""
    if derivation.spec.swing_up is None:
        return ()
    rows = []
    for d in derivation.block("swing_up").definitions:
        shown = f"\\mathrm{{{d.symbol.name.replace('_', chr(92) + '_')}}}"
        rows.append(
            Equation(
                d.description,
                f"{shown} = {printer.doprint(d.expression)}",
                f"{d.symbol.name} = {_text(d.expression)}",
            )
        )
    gains, limit = derivation.spec.swing_up, derivation.block("swing_up_limit")
    bound = limit.expanded(limit.results[0])
    rows.append(
        Equation(
            "regular in every state if and only if, for all q",
            f"{printer.doprint(gains.rate / gains.energy)} > {printer.doprint(bound)}",
            f"{gains.rate / gains.energy} > {_text(bound)}",
        )
    )
    return (Section("Energy swing-up", tuple(rows)),)


def _text(value: sp.Basic) -> str:
    if isinstance(value, sp.MatrixBase):
        rows = ("[" + ", ".join(map(str, value.row(i))) + "]" for i in range(value.rows))
        return "[" + ", ".join(rows) + "]"
    return str(value)


def derivation_text(derivation: Derivation) -> str:
    """Return the derivation as plain text."""
    lines = [f"{derivation.spec.title}", f"source: {derivation.spec.source}"]
    for section in sections(derivation):
        lines += ["", section.heading]
        lines += [f"  {e.text}    ({e.caption})" for e in section.equations]
    return "\n".join(lines) + "\n"


def derivation_markdown(derivation: Derivation) -> str:
    """Return the derivation as Markdown with LaTeX display equations."""
    lines = [f"# {derivation.spec.title}: derivation", "", f"Source: {derivation.spec.source}."]
    for section in sections(derivation):
        lines += ["", f"## {section.heading}"]
        for e in section.equations:
            lines += ["", f"{e.caption}:", "", f"$${e.latex}$$"]
    return "\n".join(lines) + "\n"


def derivation_latex(derivation: Derivation) -> str:
    """Return the derivation as a LaTeX document."""
    lines = [
        "\\documentclass{article}",
        "\\usepackage{amsmath}",
        "\\begin{document}",
        f"\\section*{{{derivation.spec.title}: derivation}}",
    ]
    for section in sections(derivation):
        lines.append(f"\\subsection*{{{_escaped(section.heading)}}}")
        for e in section.equations:
            lines += [f"{_escaped(e.caption)}:", f"\\[ {e.latex} \\]"]
    lines.append("\\end{document}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("_", "\\_").replace("^", "\\^{}").replace("&", "\\&")


def derivation_json(derivation: Derivation) -> str:
    """Return the derivation as JSON: sections with captions, LaTeX and text; identities."""
    document = {
        "model": derivation.spec.name,
        "title": derivation.spec.title,
        "source": derivation.spec.source,
        "sections": [asdict(s) for s in sections(derivation)],
        "identities": [{"name": i.name, "proved": i.proved} for i in derivation.identities],
    }
    return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
