"""The page of questions and messages quotes messages that the program has, so that no entry goes stale."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs/faq.md"
SOURCES = ("labbook", "backends", "web")
GAP = "\0"
"""Stands for what an f-string fills in: no quoted fragment reaches across it."""


def quoted(page: str) -> list[str]:
    """The fragments of messages that a page quotes: code in its headings of the third level."""
    headings = re.findall(r"^### (.+)$", page, re.MULTILINE)
    return [code for heading in headings for code in re.findall(r"`([^`]+)`", heading)]


def plain(text: str) -> str:
    """Without what a line break or a kind of quote changes."""
    return re.sub(r"\s+", " ", re.sub("[\"'`‘’“”]", "'", text))


def literals(source: str) -> list[str]:
    """The texts in a module, adjacent ones joined, without docstrings."""
    tree = ast.parse(source)
    idle = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    found = []
    for node in ast.walk(tree):
        if id(node) in idle or id(node) in parts:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node.value)
        elif isinstance(node, ast.JoinedStr):
            found.append("".join(str(one.value) if isinstance(one, ast.Constant) else GAP for one in node.values))
    return [plain(text) for text in found]


@cache
def said() -> tuple[str, ...]:
    """Every text in the sources."""
    modules = [path for folder in SOURCES for path in sorted((ROOT / folder).rglob("*.py"))]
    return tuple(text for path in modules for text in literals(path.read_text(encoding="utf-8")))


def is_said(fragment: str, texts: tuple[str, ...]) -> bool:
    """Whether a text has the fragment, as whole words."""
    pattern = re.compile(rf"(?<!\w){re.escape(plain(fragment))}(?!\w)")
    return any(pattern.search(text) for text in texts)


@pytest.mark.parametrize("fragment", quoted(PAGE.read_text(encoding="utf-8")))
def test_a_quoted_message_is_in_the_sources(fragment):
    assert is_said(fragment, said()), f"no message has the words: {fragment}"


def test_the_page_quotes_messages():
    fragments = quoted(PAGE.read_text(encoding="utf-8"))
    assert len(fragments) >= 20
    assert len(set(fragments)) == len(fragments)


def test_a_message_that_is_gone_is_noticed():
    assert not is_said("the widget has no gasket", said())
    assert not is_said("unknown ke", said())  # no whole word


def test_texts_are_read_as_they_are_shown():
    source = '''
def refuse(n):
    """The docstring says nothing to users."""
    raise ValueError(f"{n} grains "
                     "are too many; use \\"fewer\\"")
'''
    texts = tuple(literals(source))
    assert is_said("grains are too many; use 'fewer'", texts)
    assert not is_said("the docstring says nothing", texts)
    assert not is_said("n grains", texts)
