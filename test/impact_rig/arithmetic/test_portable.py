# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Nothing that computes a sample or an impact calls a function that differs between machines, in sources and library.

Libm, BLAS, LAPACK and NumPy's sums may give other last bits on another machine, and a power of floats calls pow of
libm. The remaining calls are listed here, with the reason why no sample and no impact depends on them.
"""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import impact_rig
from impact_rig import kernels
from impact_rig.kernels import build

ROOT = Path(impact_rig.__file__).parent
PARTS = ("arithmetic", "physics", "instruments", "rig", "analysis/impacts.py", "codec.py")
EXACT = {"ceil", "floor", "frexp", "rint", "sqrt", "trunc"}
"""Functions of libm whose results IEEE 754 fixes."""
PLAIN_C = {"abort", "calloc", "free", "memcmp", "memcpy", "memmove", "memset", "strcmp", "strcpy", "strdup", "strlen"}
"""C functions that `library.c` and copies of records need."""

LIBM = {"exp", "expm1", "exp2", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"}
LIBM |= {
    "sinh",
    "cosh",
    "tanh",
    "arcsin",
    "arccos",
    "arctan",
    "arctan2",
    "pow",
    "power",
    "float_power",
    "hypot",
    "cbrt",
}
SUMS = {"sum", "mean", "average", "prod", "cumsum", "cumprod", "dot", "vdot", "inner", "outer", "matmul", "einsum"}
SUMS |= {"var", "std", "convolve", "interp", "polyfit", "polyval", "trapezoid", "nansum", "linalg", "fft", "reduce"}
FORBIDDEN = {f"{module}.{name}" for module in ("math", "np", "numpy", "cmath") for name in LIBM | SUMS}
METHODS = {"sum", "mean", "prod", "dot", "std", "var", "cumsum"}
MODULES = {"scipy", "cmath"}

ALLOWED = {
    "physics/linear.py: np.linalg": "where the refinement of eigenvalues starts; they do not depend on it",
    **dict.fromkeys(
        (f"physics/contact/springs.py: math.{name}" for name in ("log", "exp", "sin", "cos", "atan2")),
        "only shown to people: the restitution of kelvin_voigt with early release",
    ),
    "physics/linear_response.py": "what simulation and analysis are held against",
    "instruments/sensor.py: np.prod": "the frequency response, used to judge readings",
    "physics/function_generator.py: np.cumsum": "counts ticks, which are integers",
    "instruments/checks.py": "judges readings and feeds none",
    "arithmetic/precise.py: sum": "of Decimals",
    "instruments/sensor.py: sum": "of Decimals",
    "instruments/sensor.py: **": "a whole power of a Decimal",
}


def dotted(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def imported(node: ast.Import | ast.ImportFrom) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]


def written_down(node: ast.expr) -> bool:
    """Return whether a node is a constant number; a power of two such as 2.0**-52 is computed once, exactly."""
    return isinstance(node, (ast.Constant, ast.UnaryOp))


def offence(node: ast.AST) -> str | None:
    """Return the part of this node whose result may depend on the machine or the version of Python."""
    match node:
        case ast.Attribute(attr=last) if dotted(node) in FORBIDDEN or last == "reduce":
            return dotted(node)
        case ast.Call(func=ast.Attribute(attr=last)) if last in METHODS and dotted(node.func) not in FORBIDDEN:
            return f".{last}()"
        case ast.Call(func=ast.Name(id="sum")):  # of floats it is compensated from Python 3.12 on
            return "sum"
        case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
            return "@"
        case ast.BinOp(left=left, op=ast.Pow(), right=right) if not (written_down(left) and written_down(right)):
            return "**"
        case ast.AugAssign(op=ast.Pow()):
            return "**"
        case ast.keyword(arg="fastmath"):
            return "fastmath"
        case ast.Import() | ast.ImportFrom():
            return next((n for n in imported(node) if n.split(".")[0] in MODULES or n in FORBIDDEN), None)
    return None


def offences(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Return line and name of everything that may differ between machines."""
    for node in ast.walk(tree):
        found = offence(node)
        if found is not None:
            yield getattr(node, "lineno", 0), found


def is_kernel(node: ast.AST) -> bool:
    if not isinstance(node, ast.FunctionDef):
        return False
    marks = [mark.func if isinstance(mark, ast.Call) else mark for mark in node.decorator_list]
    return bool({"kernel", "entry"} & {dotted(mark) for mark in marks})


def sources() -> Iterator[tuple[str, ast.AST]]:
    """Return name and text of the code that computes samples and impacts: some files, and the kernels of all others."""
    for path in sorted(ROOT.rglob("*.py")):
        name, tree = path.relative_to(ROOT).as_posix(), ast.parse(path.read_text())
        if name.startswith(tuple(f"{part}/" for part in PARTS)) or name in PARTS:
            yield name, tree
        else:
            yield from ((name, node) for node in ast.walk(tree) if is_kernel(node))


@pytest.mark.heavy
def test_no_computation_of_a_sample_depends_on_the_machine() -> None:
    found, used = [], set()
    for name, tree in sources():
        for line, what in offences(tree):
            reason = next((key for key in (name, f"{name}: {what}") if key in ALLOWED), None)
            used.add(reason)
            if reason is None:
                found.append(f"{name}:{line}: {what}")
    assert not found, "\n".join(found)
    assert used - {None} == set(ALLOWED), "an exception without a use"


@pytest.mark.skipif(kernels.MODE != "library", reason="kernels run otherwise here")
def test_the_library_calls_no_inexact_function() -> None:
    """The compiler also turns operators into calls of libm, such as `x ** n` into pow."""
    command = ["nm", "--dynamic", "--undefined-only", "--format=just-symbols", str(build.FOLDER / build.OUTPUT)]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    called = {line.partition("@")[0] for line in listed.split()}
    called = {name for name in called if not name.startswith(("Py", "_Py", "__", "_ITM"))}
    assert "floor" in called
    assert not called - EXACT - PLAIN_C


@pytest.mark.parametrize(
    "source",
    [
        "math.exp(x)",
        "np.sin(x)",
        "np.linalg.eig(m)",
        "values.mean(axis=1)",
        "a @ b",
        "x ** 2",
        "x **= 2",
        "np.add.reduce(x)",
        "from scipy import signal",
        "from math import hypot",
        "sum(x)",
        "njit(fastmath=True)",
    ],
)
def test_the_search_finds_expressions_that_depend_on_the_machine(source: str) -> None:
    assert list(offences(ast.parse(source)))


@pytest.mark.parametrize("source", ["math.sqrt(x)", "np.rint(x) * y", "2.0**-52", "math.fsum(x)", "x.max()", "exp(x)"])
def test_the_search_accepts_expressions_that_are_exact_everywhere(source: str) -> None:
    assert not list(offences(ast.parse(source)))
