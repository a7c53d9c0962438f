"""Kernel signatures have sections: `# in` is read, `# in and out` read and written, `# out` only written.

Sums and lists that a launch adds to are written too. A section ends where the next begins, and may come again.
"""

import ast
import io
import tokenize
from pathlib import Path

import pytest

KERNELS = Path(__file__).resolve().parents[2] / "kernels"
TESTS = Path(__file__).parent
SECTIONS = ("in", "in and out", "out")


def is_kernel(function: ast.FunctionDef) -> bool:
    """Whether a decorator of the function is `wp.kernel` or `lane_kernel`, called or not."""
    decorators = [d.func if isinstance(d, ast.Call) else d for d in function.decorator_list]
    return any(ast.unparse(d) in ("wp.kernel", "lane_kernel") for d in decorators)


def kernels_of(source: str) -> list[ast.FunctionDef]:
    """The kernels of a module."""
    return [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef) and is_kernel(n)]


def comments_of(source: str) -> dict[int, str]:
    """The comments that have a line to themselves, by line."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        t.start[0]: t.string.removeprefix("# ")
        for t in tokens
        if t.type == tokenize.COMMENT and t.line.lstrip().startswith("#")
    }


def sections_of(kernel: ast.FunctionDef, comments: dict[int, str]) -> dict[str, str]:
    """The section of each parameter: the last comment above it in the signature; empty where there is none."""
    return {
        p.arg: next((comments[i] for i in range(p.lineno, kernel.lineno, -1) if i in comments), "")
        for p in kernel.args.args
    }


def base_name(target: ast.expr) -> str | None:
    """The variable that a chain of attributes and subscripts begins with."""
    while isinstance(target, ast.Attribute | ast.Subscript):
        target = target.value
    return target.id if isinstance(target, ast.Name) else None


def stores_of(kernel: ast.FunctionDef) -> set[str | None]:
    """The variables whose elements the body of a kernel assigns, or changes by an atomic operation."""
    stored = {base_name(n) for n in ast.walk(kernel) if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)}
    atomic = {
        base_name(n.args[0])
        for n in ast.walk(kernel)
        if isinstance(n, ast.Call) and ast.unparse(n.func).startswith("wp.atomic_")
    }
    return stored | atomic


def mistakes_in(source: str) -> list[str]:
    """What is wrong with the signatures of a module's kernels."""
    comments = comments_of(source)
    found = []
    for kernel in kernels_of(source):
        sections, stored = sections_of(kernel, comments), stores_of(kernel)
        for name, section in sections.items():
            if section not in SECTIONS:
                found.append(f"{kernel.name}: {name} is under {section!r}")
            elif section == "in" and name in stored:
                found.append(f"{kernel.name}: {name} is under 'in' and written")
    return found


@pytest.mark.parametrize(
    "path", [*sorted(KERNELS.glob("*.py")), *sorted(TESTS.glob("test_kernel_*.py"))], ids=lambda p: p.name
)
def test_parameters_stand_under_what_the_kernel_does_to_them(path):
    assert mistakes_in(path.read_text("utf-8")) == []


def test_every_decorated_function_is_looked_at():
    sources = [path.read_text("utf-8") for path in KERNELS.glob("*.py")]
    decorated = sum(source.count("\n@wp.kernel") + source.count("\n@lane_kernel") for source in sources)
    assert sum(len(kernels_of(source)) for source in sources) == decorated > 0


SIGNATURE = """
@{decorator}
def add(
    {first}
    a: wp.array[wp.int32],
    s: State,
    # out
    b_out: wp.array[wp.int32],
):
    i = wp.tid()
    c = wp.vec3()
    c[0] = 1.0
    {body}
"""


def mistakes(first="# in", body="b_out[i] = a[i] + s.x[i]", decorator="wp.kernel"):
    return mistakes_in(SIGNATURE.format(first=first, body=body, decorator=decorator))


@pytest.mark.parametrize("decorator", ["wp.kernel", "wp.kernel(enable_backward=False)", "lane_kernel(a=POINTS_ARRAY)"])
@pytest.mark.parametrize("first", ["# in", "# in and out"])
def test_signature_with_sections_passes(first, decorator):
    assert mistakes(first, decorator=decorator) == []


@pytest.mark.parametrize("first", ["", "# inputs", "# outputs"])
@pytest.mark.parametrize("decorator", ["wp.kernel", "lane_kernel(a=POINTS_ARRAY)"])
def test_signature_without_a_section_is_found(first, decorator):
    given = first.removeprefix("# ")
    expected = [f"add: a is under {given!r}", f"add: s is under {given!r}"]
    assert mistakes(first, decorator=decorator) == expected


@pytest.mark.parametrize(
    ("body", "name"),
    [
        ("a[i] = 1", "a"),
        ("a[i] += 1", "a"),
        ("wp.atomic_add(a, i, 1)", "a"),
        ("b_out[i] = wp.atomic_max(a, i, 1)", "a"),
        ("s.x[i] = 1", "s"),
        ("s.inner.x[a[i]] = 1", "s"),
        ("wp.atomic_min(s.x, a[i], 1)", "s"),
    ],
)
def test_write_to_a_parameter_under_in_is_found(body, name):
    assert mistakes(body=body) == [f"add: {name} is under 'in' and written"]


@pytest.mark.parametrize("body", ["b_out[a[i]] = s.x[i]", "wp.atomic_add(b_out, a[i], s.x[i])"])
def test_parameter_that_is_an_index_or_a_value_of_a_write_is_only_read(body):
    assert mistakes(body=body) == []
