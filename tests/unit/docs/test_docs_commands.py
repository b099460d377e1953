"""The documentation says what the program does: commands, options, make targets, links."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer.main
from typer.core import TyperGroup
from typer.exceptions import TyperException

from labbook.cli import COMMANDS, build
from labbook.cli.reference import WIDTH, markdown

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.fixture(scope="module")
def group():
    command = typer.main.get_command(build())
    assert isinstance(command, TyperGroup)
    return command


def snippets(page: Path) -> list[list[str]]:
    """Commands of a page's ```sh blocks, as words."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def test_docs_commands_is_what_the_help_texts_say():
    written = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    assert written == markdown(), "the help texts have changed: run `make docs`"


def test_every_verb_has_its_section(group):
    sections = set(re.findall(r"^## labbook (\S+)$", markdown(), re.MULTILINE))
    assert sections == set(group.commands)
    assert {verb.rstrip("_").replace("_", "-") for verb in COMMANDS} <= sections


def test_every_verb_and_option_has_a_help_text(group):
    for name, command in group.commands.items():
        assert command.help, name
        for parameter in command.params:
            assert getattr(parameter, "help", None), f"{name}: {parameter.name}"


def test_the_program_prints_the_same_help():
    code = "from labbook.cli import main; main()"
    environment = {**os.environ, "COLUMNS": str(WIDTH), "TERMINAL_WIDTH": str(WIDTH)}
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "backends")])
    shown = subprocess.run(
        [sys.executable, "-c", code, "fit", "--help"], env=environment, capture_output=True, text=True, check=True
    ).stdout
    section = markdown().split("## labbook fit\n")[1].split("```text\n")[1].split("\n```")[0]
    assert re.sub(r"\s+", " ", shown.split("Usage:")[1]).strip() == re.sub(
        r"\s+", " ", section.split("Usage:")[1]
    ).strip().replace("labbook fit", shown.split("Usage:")[1].split(" [")[0].strip())


def labbook_lines(page: Path) -> list[list[str]]:
    """Words after `labbook` of the commands in a page: lines of ```sh blocks, then code within sentences.

    There, a verb alone is spoken of, and is no line to type.
    """
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    spoken = [words for code in re.findall(r"`(labbook [^`]+)`", text) if len(words := shlex.split(code)) > 2]
    return [words[1:] for words in [*snippets(page), *spoken] if words[0] == "labbook" and len(words) > 1]


def parse(group: TyperGroup, words: list[str]) -> None:
    """Read a command line as the program would, without carrying it out. Raises TyperException."""
    if words[0] not in group.commands:
        raise typer.BadParameter(f"no verb {words[0]}")
    group.commands[words[0]].make_context(words[0], list(words[1:]))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_labbook_lines_in_the_pages_are_real(page, group):
    """Each is read as the program reads it; the studies it names are there, on the page, or made by an earlier line."""
    made = {f"{name}.yaml" for name in re.findall(r"```yaml\nname: (\S+)", page.read_text(encoding="utf-8"))}
    for words in labbook_lines(page):
        parse(group, words)
        if words[0] == "new-extension":
            made.add("study.yaml")
        if words[0] == "new":
            made.add(f"{words[1]}.yaml")
        for name in (word for word in words[1:] if word.endswith(".yaml")):
            assert name in made or (ROOT / name).exists(), f"{page.name}: {name} is not there"


@pytest.mark.parametrize(
    "line", ["frun a.yaml", "run", "run a.yaml b.yaml", "run a.yaml --lanes 2", "run a.yaml --checkpoint-every soon"]
)
def test_a_line_that_is_not_real_is_noticed(line, group):
    with pytest.raises(TyperException):
        parse(group, line.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_other_commands_in_the_pages_exist(page):
    targets = set(re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    for words in snippets(page):
        if words[0] == "make":
            assert {word for word in words[1:] if "=" not in word} <= targets, f"{page.name}: {words}"
        elif words[:2] == ["pip", "install"]:
            for asked in re.findall(r"\[([\w,]+)\]", " ".join(words)):
                assert set(asked.split(",")) <= extras, f"{page.name}: {words}"


def test_the_readme_shows_the_two_commands_of_the_makefile():
    shown = [words[:2] for words in snippets(ROOT / "README.md")]
    assert ["make", "quickstart"] in shown
    assert ["make", "test"] in shown


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_in_the_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}, which is not there"
