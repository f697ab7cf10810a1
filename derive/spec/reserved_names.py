"""Names that nothing of a plant may have, and why: one list, for the checks and for the documents.

Our own names are not among them: they give way (`own_names`). What is reserved means something to
a compiler, to Python, or to every model: no generation could give it another meaning.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping

from pfaffian.derive.ir.names import POLES_KEY, TIME_NAME

#: Keywords of C up to C23 and of C++ up to C++20; a generated header is for both.
C_KEYWORDS = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t
    char8_t class co_await co_return co_yield compl concept const const_cast consteval constexpr
    constinit continue decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq
    nullptr operator or or_eq private protected public register reinterpret_cast requires restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof typeof_unqual union unsigned using
    virtual void volatile wchar_t while xor xor_eq
"""
#: What compilers define without being asked, for some target and in some mode.
PREDEFINED = """
    AVR MIPSEB MIPSEL PPC WIN32 WIN64 WINNT hpux i386 linux m68k mc68000 mips mips64 powerpc sgi
    sparc sun unix vax
"""
#: What the standard headers define that generated code includes, or firmware beside it.
MACROS = """
    CHAR_BIT CHAR_MAX CHAR_MIN EDOM EILSEQ EOF ERANGE FALSE FLT_EVAL_METHOD FLT_ROUNDS FP_FAST_FMA
    FP_FAST_FMAF FP_INFINITE FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO HUGE_VAL HUGE_VALF HUGE_VALL
    INFINITY INT_MAX INT_MIN LLONG_MAX LLONG_MIN LONG_MAX LONG_MIN MB_LEN_MAX NAN NDEBUG NULL
    RAND_MAX SCHAR_MAX SCHAR_MIN SHRT_MAX SHRT_MIN TRUE UCHAR_MAX UINT_MAX ULLONG_MAX ULONG_MAX
    USHRT_MAX assert complex errno imaginary isfinite isinf isnan isnormal noreturn offsetof signbit
    stderr stdin stdout
"""
#: Types that generated code names.
TYPES = "size_t ptrdiff_t max_align_t nullptr_t"
#: The shapes of further names of `stdint.h`, `float.h` and `math.h`.
_SHAPES = re.compile(
    r"u?int(_least|_fast)?(8|16|32|64)_t|u?int(ptr|max)_t"
    r"|U?INT(_LEAST|_FAST)?(8|16|32|64)_(MAX|MIN|C)|U?INT(PTR|MAX)_(MAX|MIN|C)"
    r"|(PTRDIFF|SIZE|SIG_ATOMIC|WCHAR|WINT)_(MAX|MIN)"
    r"|(FLT|DBL|LDBL)_[A-Z0-9_]+|DECIMAL_DIG|M_(E|LOG2E|LOG10E|LN2|LN10|[12]_PI|PI(_[24])?|2_SQRTPI|SQRT(2|1_2))"
)
#: What the complete controller and its file have beside what is called after coordinates and
#: actuators.
CONTROLLER = """
    energy fault form law law_status mode output params phase place reason residual singular_ratio
    status sum torque_jump
"""
#: Headers of C that a model's own header would hide.
_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign
    stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
    wchar wctype
"""
#: Endings of the macros and status codes of a model, after its name in capitals.
_OF_MODEL = """
    BAD_INPUT BAD_PARAMETER BALANCE_FEEDBACK BALANCE_NOMINAL BALANCE_ROBUST BATCH_H CONTINUOUS_H
    CONTROL_H FOLLOW_H H JACOBIAN_H NEAR_SINGULAR NUMERIC OK PARAMS_H PHASE_ENERGY PHASE_PLAN
    PHASE_WAITING PLANT_H PLAN_H SATURATED SWING_UP_ENERGY SWING_UP_H SWING_UP_NONE SWING_UP_PLAN
"""
_PYTHON = frozenset(keyword.kwlist)
_REASONS: Mapping[str, str] = {
    **dict.fromkeys(TYPES.split(), "is a type of C"),
    **dict.fromkeys(MACROS.split(), "is a macro of the headers of C"),
    **dict.fromkeys(PREDEFINED.split(), "is a macro that compilers define for some target"),
    **dict.fromkeys(_PYTHON, "is a keyword of Python"),
    **dict.fromkeys(C_KEYWORDS.split(), "is a keyword of C or C++"),
    POLES_KEY: "is how a parameter set gives poles instead of gains",
    TIME_NAME: "is the time of servo-constraints that vary with it, and nothing else",
}
#: Prefix of every name of the runtime in C, in any case.
PREFIX = "pf_"


def reserved_words() -> tuple[str, ...]:
    """Return every reserved name that is not told by its shape, sorted: the documents list them."""
    return tuple(sorted(_REASONS, key=lambda name: (name.lower(), name)))


def objection(name: object, model: str = "", *, member: bool = False) -> str:
    """Return why nothing of a plant may be called `name`: what it is instead. Empty: it may.

    `member` says that it is a coordinate or an actuator, which the complete controller has members
    for; `model` is the name of the plant, in capitals the prefix of its status codes.
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        return "is no identifier in C: take ASCII letters, digits and underscores, a letter first"
    if name.lower().startswith(PREFIX):
        return f"begins with {PREFIX}, as the names of the runtime do"
    if _SHAPES.fullmatch(name):
        return "is a name of the headers of C"
    if name in {f"{model.upper()}_{ending}" for ending in _OF_MODEL.split()}:
        return "is a constant of the generated code"
    if member and name in CONTROLLER.split():
        return "is a name of the complete controller, where coordinates and actuators are too"
    return _REASONS.get(name, "")


def objection_to_model(name: object) -> str:
    """Return why no model may be called `name`; empty where one may."""
    if isinstance(name, str) and name in _HEADERS.split():
        return "is a header of C, which the model's own would hide"
    return objection(name)
