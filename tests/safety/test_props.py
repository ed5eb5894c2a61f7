"""Text of a file never becomes part of a string that the page's library takes apart or runs."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "spiral" / "app").rglob("*.py"))
PARSED = ("props", "classes")
"""Methods whose text NiceGUI takes apart; a value inside could add a prop that is run."""
RUN = ("run_javascript", "add_head_html", "markdown", "code")
"""Functions whose text is run, or read as Markdown."""


def plain(node):
    """Text as it stands in the source: no value can enter it."""
    if isinstance(node, ast.IfExp):
        return plain(node.body) and plain(node.orelse)
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def called(tree, names):
    """Calls of methods or functions of these names on NiceGUI's elements."""
    calls = (n for n in ast.walk(tree) if isinstance(n, ast.Call))
    return [n for n in calls if isinstance(n.func, ast.Attribute) and n.func.attr in names]


def constants_of(tree):
    """Names that a module gives plain text."""
    return {
        target.id for node in tree.body if isinstance(node, ast.Assign) and plain(node.value)
        for target in node.targets if isinstance(target, ast.Name)
    }  # fmt: skip


def is_known(node, constants):
    """Plain text, or one of these names."""
    return plain(node) or (isinstance(node, ast.Name) and node.id in constants)


def formatted(source):
    """Calls of ``.props`` and ``.classes`` whose text is put together."""
    found = called(ast.parse(source), PARSED)
    given = [(c, [*c.args, *(k.value for k in c.keywords)]) for c in found]
    return [ast.unparse(c) for c, values in given if not all(map(plain, values))]


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.name)
def test_props_are_set_by_key_or_by_plain_text(file):
    assert formatted(file.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "box.props(f'label=\"{name}\"')",
        "box.props('label=\"%s\"' % name)",
        "box.props('label=\"{}\"'.format(name))",
        "box.props('label=' + name)",
        "box.props(look)",
        "box.props(add=look)",
        "box.props(' '.join(parts))",
        "box.classes(f'effect {name}')",
        "ui.input().props('dense').props(f'label={name}')",
        "box.props('a' if first else name)",
    ],
)
def test_what_is_put_together_is_found(source):
    assert formatted(source)


@pytest.mark.parametrize(
    "source", ["box.props('outlined dense')", "box.props['label'] = name",
               "box.props('a' if first else 'b')"]
)  # fmt: skip
def test_what_is_plain_passes(source):
    assert formatted(source) == []


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.name)
def test_no_text_is_run_or_read_as_markdown(file):
    """But a constant of the module, which no value enters."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    of_library = [c for c in called(tree, RUN) if ast.unparse(c.func.value) == "ui"]
    known = constants_of(tree)
    assert [ast.unparse(c) for c in of_library if not all(is_known(a, known) for a in c.args)] == []
    assert not any(c.keywords for c in of_library)


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.name)
def test_scripts_of_handlers_are_plain_text(file):
    """``js_handler=...`` is run in the browser: a literal, or a constant of its module."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    constants = constants_of(tree)
    given = [
        k.value for node in ast.walk(tree) if isinstance(node, ast.Call)
        for k in node.keywords if k.arg == "js_handler"
    ]  # fmt: skip
    assert all(is_known(v, constants) for v in given)


def test_keys_of_props_are_plain_and_name_no_expression():
    """A prop whose name begins with a colon is run by Vue."""
    for file in FILES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in (n for n in ast.walk(tree) if isinstance(n, ast.Subscript)):
            if ast.unparse(node.value).rpartition(".")[2] in ("props", "_props"):
                assert plain(node.slice), ast.unparse(node)
                assert node.slice.value[:1].isalpha(), ast.unparse(node)
